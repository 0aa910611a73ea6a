"""RAFT, the recurrent network of optical flow (Teed and Deng, ECCV 2020), in its large form.

Two published layouts load into it: the original ``raft-things.pth`` and torchvision's ``raft_large``. An iteration
computes only what differs from the one before: the gates' convolutions of the context are computed once, and the
weights of the upsampling after the last iteration.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception import weights
from anystyle.perception.features import Frozen, load_frozen

SMALLEST = 128
"""Below this many pixels a side the coarsest level of correlations is one pixel wide, and the flow is not a number."""

STATE, CONTEXT, MOTION = slice(0, 128), slice(128, 256), slice(256, 384)
"""The input channels of the recurrent unit's convolutions."""

PADDING = {1: (0, 2), 2: (2, 0)}
"""Of the recurrent unit's halves: the first convolves along rows, the second along columns."""


class Context(NamedTuple):
    """What depends on the source frame alone.

    Args:
        state: The initial hidden state.
        gates: The convolutions of the context in the gates z, r, q of both halves of the recurrent unit, with biases.
    """

    state: Float[Tensor, "M 128 h w"]
    gates: Float[Tensor, "M 768 h w"]


class Raft(Frozen):
    """RAFT large, 5.26 M parameters, under the keys of the original file without its prefix."""

    def __init__(self) -> None:
        super().__init__()
        self.fnet = Encoder(InstanceNorm)
        self.cnet = Encoder(nn.BatchNorm2d)
        self.update_block = Update()

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 256 h w"]:
        """Features that are matched, at an eighth of the size.

        Args:
            images: sRGB in [0, 1]; sides are multiples of 8, at least 128.
        """
        return self.fnet(2 * images - 1)

    def context(self, images: Float[Tensor, "M 3 H W"]) -> Context:
        """The context of source frames, sRGB in [0, 1]."""
        state, context = self.cnet(2 * images - 1).split(128, dim=1)
        return Context(state.tanh(), self.update_block.gru.context_gates(F.relu(context)))

    def flow(
        self,
        source: Float[Tensor, "M 256 h w"],
        target: Float[Tensor, "M 256 h w"],
        context: Context,
        iterations: int = 32,
    ) -> Float[Tensor, "M 2 H W"]:
        """The flow, (x, y) in pixels, pair by pair, of what :meth:`describe` gives; the context is the source's."""
        pyramid = correlation_pyramid(source, target)
        # In one layout with what is looked up, or else each concatenation copies.
        pixels, state, gates = (
            part.contiguous(memory_format=torch.channels_last) for part in (_pixel_grid(source), *context)
        )
        halves = self.update_block.gru.halves(gates)
        flow = torch.zeros_like(pixels)
        for _ in range(iterations):
            state, change = self.update_block(state, halves, look_up(pyramid, pixels + flow), flow)
            flow = flow + change
        return upsample(flow, self.update_block.upsampling_logits(state))


def load(name: str = "raft_things", path: str | Path | None = None) -> Raft:
    """The network with published weights, ``raft_things`` or ``raft_large``, of either layout.

    Raises:
        ValueError: The file does not hold its weights.
        FileNotFoundError: They are missing.
    """
    file = weights.find(name, path)
    return load_frozen(Raft(), original_keys(weights.read(file)), file)


def original_keys(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A published state dict of either layout under the original's keys; unknown keys stay as they are."""
    state = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    if any(key.startswith("feature_encoder.") for key in state):
        return {_from_torchvision(key): tensor for key, tensor in state.items()}
    # The original registers one module twice, as `norm3` and as `downsample.1`.
    return {key: tensor for key, tensor in state.items() if ".norm3." not in key}


_RENAMED = (
    ("feature_encoder.", "fnet."),
    ("context_encoder.", "cnet."),
    ("fnet.convnormrelu.0.", "fnet.conv1."),
    ("cnet.convnormrelu.0.", "cnet.conv1."),
    ("cnet.convnormrelu.1.", "cnet.norm1."),
    (".convnormrelu1.0.", ".conv1."),
    (".convnormrelu1.1.", ".norm1."),
    (".convnormrelu2.0.", ".conv2."),
    (".convnormrelu2.1.", ".norm2."),
    ("net.conv.", "net.conv2."),
    ("update_block.motion_encoder.convcorr1.0.", "update_block.encoder.convc1."),
    ("update_block.motion_encoder.convcorr2.0.", "update_block.encoder.convc2."),
    ("update_block.motion_encoder.convflow1.0.", "update_block.encoder.convf1."),
    ("update_block.motion_encoder.convflow2.0.", "update_block.encoder.convf2."),
    ("update_block.motion_encoder.conv.0.", "update_block.encoder.conv."),
    *((f"recurrent_block.convgru{half}.conv{gate}.", f"gru.conv{gate}{half}.") for half in "12" for gate in "zrq"),
    ("mask_predictor.convrelu.0.", "update_block.mask.0."),
    ("mask_predictor.conv.", "update_block.mask.2."),
)


def _from_torchvision(key: str) -> str:
    for old, new in _RENAMED:
        key = key.replace(old, new)
    return key


def upsample(flow: Float[Tensor, "M 2 h w"], logits: Float[Tensor, "M 576 h w"]) -> Float[Tensor, "M 2 H W"]:
    """Flow at eight times the size: each fine pixel is a convex combination of the 3 x 3 coarse ones around it."""
    batch, _, height, width = flow.shape
    convex = logits.unflatten(1, (9, 64)).softmax(dim=1)  # M 9 64 h w
    neighbours = F.unfold(8 * flow, 3, padding=1).reshape(batch, 2, 9, height, width)
    fine = torch.einsum("mcnhw,mnshw->mcshw", neighbours, convex)
    return F.pixel_shuffle(fine.flatten(1, 2), 8)


def _pixel_grid(like: Float[Tensor, "M C h w"]) -> Float[Tensor, "M 2 h w"]:
    """The coordinates (x, y) of every pixel."""
    height, width = like.shape[-2:]
    y = torch.arange(height, dtype=like.dtype, device=like.device)
    x = torch.arange(width, dtype=like.dtype, device=like.device)
    return torch.stack(torch.meshgrid(x, y, indexing="xy")).expand(like.shape[0], -1, -1, -1)


class InstanceNorm(nn.Module):
    """``nn.InstanceNorm2d``, which copies images that lie channels last and takes four times as long."""

    def __init__(self, channels: int) -> None:
        super().__init__()

    def forward(self, x: Float[Tensor, "M C H W"]) -> Float[Tensor, "M C H W"]:
        """Each channel of each image with mean 0 and variance 1."""
        x = x - x.mean((2, 3), keepdim=True)
        return x * (x.square().mean((2, 3), keepdim=True) + 1e-5).rsqrt()


class Encoder(nn.Module):
    """Residual blocks down to an eighth of the size.

    Args:
        norm: Makes a normalisation of so many channels.
    """

    def __init__(self, norm: Callable[[int], nn.Module]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3)
        self.norm1 = norm(64)
        self.layer1 = nn.Sequential(Residual(64, 64, 1, norm), Residual(64, 64, 1, norm))
        self.layer2 = nn.Sequential(Residual(64, 96, 2, norm), Residual(96, 96, 1, norm))
        self.layer3 = nn.Sequential(Residual(96, 128, 2, norm), Residual(128, 128, 1, norm))
        self.conv2 = nn.Conv2d(128, 256, 1)

    def forward(self, x: Tensor) -> Tensor:
        """256 channels."""
        x = F.relu(self.norm1(self.conv1(x)), inplace=True)
        return self.conv2(self.layer3(self.layer2(self.layer1(x))))


class Residual(nn.Module):
    """Two 3x3 convolutions beside their input."""

    def __init__(self, channels: int, width: int, stride: int, norm: Callable[[int], nn.Module]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, width, 3, stride=stride, padding=1)
        self.norm1 = norm(width)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)
        self.norm2 = norm(width)
        self.downsample = nn.Sequential()
        if stride > 1:
            self.downsample.append(nn.Conv2d(channels, width, 1, stride=stride)).append(norm(width))

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.norm1(self.conv1(x)), inplace=True)
        y = F.relu(self.norm2(self.conv2(y)), inplace=True)
        return F.relu(self.downsample(x) + y, inplace=True)


class Update(nn.Module):
    """One step of the recurrence."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Motion()
        self.gru = Recurrent()
        self.flow_head = Head()
        self.mask = nn.Sequential(nn.Conv2d(128, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 64 * 9, 1))

    def forward(
        self, state: Tensor, halves: Sequence["Half"], correlation: Tensor, flow: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The next hidden state, and the change of the flow.

        Args:
            state: The hidden state, ``M 128 h w``.
            halves: Of the recurrent unit.
            correlation: Windows of correlations around the current flow, ``M 324 h w``.
            flow: The current flow, ``M 2 h w``.
        """
        state = self.gru(state, halves, self.encoder(correlation, flow))
        return state, self.flow_head(state)

    def upsampling_logits(self, state: Float[Tensor, "M 128 h w"]) -> Float[Tensor, "M 576 h w"]:
        """Logits of the upsampling's weights; a quarter, as published, to balance gradients."""
        return self.mask(state).mul_(0.25)


class Motion(nn.Module):
    """The motion encoder: correlations and flow in one map of features."""

    def __init__(self) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(LEVELS * WINDOW**2, 256, 1)
        self.convc2 = nn.Conv2d(256, 192, 3, padding=1)
        self.convf1 = nn.Conv2d(2, 128, 7, padding=3)
        self.convf2 = nn.Conv2d(128, 64, 3, padding=1)
        self.conv = nn.Conv2d(64 + 192, 128 - 2, 3, padding=1)

    def forward(self, correlation: Tensor, flow: Tensor) -> Tensor:
        """128 channels, the last two the flow itself."""
        correlation = self.convc2(self.convc1(correlation).relu_()).relu_()
        movement = self.convf2(self.convf1(flow).relu_()).relu_()
        return torch.cat([self.conv(torch.cat([correlation, movement], dim=1)).relu_(), flow], dim=1)


class Half(NamedTuple):
    """What one half of the recurrent unit reads in every iteration.

    Args:
        update_reset: The weights of the gates z and r over the channels of state and motion.
        proposal: The weights of q over the same.
        context: The three gates' convolutions of the context, with biases.
        padding: Of the convolutions.
    """

    update_reset: Float[Tensor, "256 256 _ _"]
    proposal: Float[Tensor, "128 256 _ _"]
    context: Float[Tensor, "M 384 h w"]
    padding: tuple[int, int]


class Recurrent(nn.Module):
    """A gated recurrent unit that convolves along rows, then along columns.

    Convolutions are linear: their part over the context's channels is the same in every iteration.
    """

    def __init__(self) -> None:
        super().__init__()
        for half, kernel in ((1, (1, 5)), (2, (5, 1))):
            for gate in "zrq":
                self.add_module(f"conv{gate}{half}", nn.Conv2d(384, 128, kernel, padding=PADDING[half]))

    def context_gates(self, context: Float[Tensor, "M 128 h w"]) -> Float[Tensor, "M 768 h w"]:
        """The three gates' convolutions of the context in both halves, with biases; see :class:`Context`."""
        gates = []
        for half in (1, 2):
            bias = torch.cat([self.get_parameter(f"conv{gate}{half}.bias") for gate in "zrq"])
            gates.append(F.conv2d(context, self._weight(half, "zrq", CONTEXT), bias, padding=PADDING[half]))
        return torch.cat(gates, dim=1)

    def halves(self, gates: Float[Tensor, "M 768 h w"]) -> list[Half]:
        """Both halves, from the output of :meth:`context_gates`."""
        return [
            Half(self._weight(half, "zr", STATE, MOTION), self._weight(half, "q", STATE, MOTION), known, PADDING[half])
            for half, known in zip((1, 2), gates.split(384, dim=1), strict=True)
        ]

    def forward(self, state: Tensor, halves: Sequence[Half], motion: Tensor) -> Tensor:
        """The next hidden state."""
        for half in halves:
            inputs = torch.cat([state, motion], dim=1)
            gates = F.conv2d(inputs, half.update_reset, padding=half.padding).add_(half.context[:, :256]).sigmoid_()
            update, reset = gates.split(128, dim=1)
            inputs[:, STATE] *= reset
            proposal = F.conv2d(inputs, half.proposal, padding=half.padding).add_(half.context[:, 256:]).tanh_()
            state = state.lerp(proposal, update)
        return state

    def _weight(self, half: int, gates: str, *channels: slice) -> Tensor:
        """The weights of these gates over these input channels, gates side by side."""
        weights = [self.get_parameter(f"conv{gate}{half}.weight") for gate in gates]
        return torch.cat([torch.cat([weight[:, part] for part in channels], dim=1) for weight in weights])


class Head(nn.Module):
    """The head that predicts the change of the flow."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(128, 256, 3, padding=1)
        self.conv2 = nn.Conv2d(256, 2, 3, padding=1)

    def forward(self, state: Tensor) -> Tensor:
        """(x, y) in pixels of an eighth of the size."""
        return self.conv2(self.conv1(state).relu_())


LEVELS, RADIUS = 4, 4
WINDOW = 2 * RADIUS + 1

Pyramid = list[Float[Tensor, "Mhw 1 _ _"]]
"""Correlations of each feature of the source with those of the target, at four sizes of the target."""


def correlation_pyramid(source: Float[Tensor, "M C h w"], target: Float[Tensor, "M C h w"]) -> Pyramid:
    """Inner products of features, divided by the root of their channels."""
    batch, channels, height, width = source.shape
    # The source is divided, not the volume, which is the largest tensor of all.
    volume = (source / channels**0.5).flatten(2).mT @ target.flatten(2)  # M hw hw
    pyramid = [volume.view(batch * height * width, 1, height, width)]
    for _ in range(LEVELS - 1):
        pyramid.append(F.avg_pool2d(pyramid[-1], 2))
    return pyramid


def look_up(pyramid: Pyramid, coords: Float[Tensor, "M 2 h w"]) -> Float[Tensor, "M 324 h w"]:
    """Correlations in a window around each target pixel, bilinear, at every size; zero outside.

    Args:
        pyramid: Of :func:`correlation_pyramid`.
        coords: For each source pixel (x, y) of its window's centre in the target, in pixels of the finest level.

    Returns:
        ``LEVELS * WINDOW**2`` channels; a window's first axis is x and its second y, as in the published network.
    """
    batch, _, height, width = coords.shape
    steps = torch.arange(-RADIUS, RADIUS + 1, dtype=coords.dtype, device=coords.device)
    window = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), dim=-1)  # 9 9 2, (x, y)
    centres = coords.permute(0, 2, 3, 1).reshape(-1, 1, 1, 2)
    windows = []
    for index, level in enumerate(pyramid):
        # `grid_sample` reads [-1, 1] from the first to the last pixel.
        scale = 2 / level.new_tensor([level.shape[-1] - 1, level.shape[-2] - 1])
        grid = centres * (scale / 2**index) + (window * scale - 1)
        sampled = F.grid_sample(level, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
        windows.append(sampled.reshape(batch, height, width, -1))
    return torch.cat(windows, dim=-1).permute(0, 3, 1, 2)
