"""RAFT, the recurrent network of optical flow (Teed and Deng, ECCV 2020), in its large form.

Two published layouts load into it: the original ``raft-things.pth`` and torchvision's ``raft_large``. The gates'
convolutions of the context are computed once, and the weights of the upsampling after the last iteration.
"""

import re
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.geometry.warp import pixels
from anystyle.vision import weights
from anystyle.vision.features import Frozen, load_frozen

SMALLEST = 128
"""Below this many pixels a side the coarsest level of correlations is one pixel wide, and the flow is not a number."""

HALVES = ((1, (1, 5), (0, 2)), (2, (5, 1), (2, 0)))
"""Number, kernel and padding of the recurrent unit's halves."""
LEVELS, RADIUS = 4, 4
WINDOW = 2 * RADIUS + 1

Pyramid = list[Float[Tensor, "Mhw 1 _ _"]]
"""Correlations of each feature of the source with those of the target, at four sizes of the target."""
Half = tuple[Tensor, Tensor, Tensor, tuple[int, int]]
"""Of the recurrent unit: weights of the gates z and r, those of q, convolutions of the context, padding."""


class RaftNetwork(Frozen):
    """RAFT large, 5.26 M parameters, under the keys of the original file without its prefix."""

    def __init__(self) -> None:
        super().__init__()
        self.fnet = Encoder(InstanceNorm)
        self.cnet = Encoder(nn.BatchNorm2d)
        self.update_block = Update()

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 256 h w"]:
        """Features, at an eighth of the size, of sRGB images in [0, 1]; sides are multiples of 8, at least 128."""
        return self.fnet(2 * images - 1)

    def context(self, images: Float[Tensor, "M 3 H W"]) -> tuple[Tensor, Tensor]:
        """The initial hidden state and the context of source frames, sRGB in [0, 1]; ``M 128 h w`` each."""
        state, context = self.cnet(2 * images - 1).split(128, dim=1)
        return state.tanh(), F.relu(context)

    def flow(
        self,
        source: Float[Tensor, "M 256 h w"],
        target: Float[Tensor, "M 256 h w"],
        context: Sequence[Float[Tensor, "M 128 h w"]],
        iterations: int = 32,
    ) -> Float[Tensor, "M 2 H W"]:
        """The flow, (x, y) in pixels, pair by pair, from the output of ``describe`` and the source's ``context``."""
        pyramid, places = correlation_pyramid(source, target), pixels(source).expand(len(source), -1, -1, -1)
        # The memory format of the correlations, without which each concatenation copies.
        places, state, known = (part.contiguous(memory_format=torch.channels_last) for part in (places, *context))
        update = self.update_block
        halves = update.gru.prepare(known)
        flow = torch.zeros_like(places)
        for _ in range(iterations):
            state = update.gru(state, halves, update.encoder(look_up(pyramid, places + flow), flow))
            flow = flow + update.flow_head(state)
        # A quarter, as published, to balance gradients.
        return upsample(flow, 0.25 * update.mask(state))


def load(name: str = "raft_things", path: str | Path | None = None) -> RaftNetwork:
    """The network with published weights, ``raft_things`` or ``raft_large``, of either layout."""
    file = weights.find(name, path)
    return load_frozen(RaftNetwork(), original_keys(weights.read(file)), file)


_RENAMED = (  # torchvision's keys
    (r"^(f|c)(eature|ontext)_encoder\.", r"\1net."),
    (r"net\.conv\.", "net.conv2."),
    (r"net\.convnormrelu\.", "net.convnormrelu1."),
    (r"convnormrelu(\d)\.0\.", r"conv\1."),
    (r"convnormrelu(\d)\.1\.", r"norm\1."),
    (r"motion_encoder\.conv\.0\.", "encoder.conv."),
    (r"motion_encoder\.conv(c|f)(?:orr|low)(\d)\.0\.", r"encoder.conv\1\2."),
    (r"recurrent_block\.convgru(\d)\.conv(\w)\.", r"gru.conv\2\1."),
    (r"^mask_predictor\.convrelu\.0\.", "update_block.mask.0."),
    (r"^mask_predictor\.conv\.", "update_block.mask.2."),
)


def original_keys(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A published state dict of either layout under the original's keys; unknown keys stay as they are."""
    torchvision = any(key.startswith("feature_encoder.") for key in state)
    renamed: dict[str, Tensor] = {}
    for key, tensor in state.items():
        key = key.removeprefix("module.")
        for old, new in _RENAMED if torchvision else ():
            key = re.sub(old, new, key)
        # The original registers one module twice, as `norm3` and as `downsample.1`.
        if torchvision or ".norm3." not in key:
            renamed[key] = tensor
    return renamed


def upsample(flow: Float[Tensor, "M 2 h w"], logits: Float[Tensor, "M 576 h w"]) -> Float[Tensor, "M 2 H W"]:
    """Flow at eight times the size: each fine pixel is a convex combination of the 3 x 3 coarse ones around it."""
    batch, _, height, width = flow.shape
    convex = logits.unflatten(1, (9, 64)).softmax(dim=1)  # M 9 64 h w
    neighbours = F.unfold(8 * flow, 3, padding=1).reshape(batch, 2, 9, height, width)
    return F.pixel_shuffle(torch.einsum("mcnhw,mnshw->mcshw", neighbours, convex).flatten(1, 2), 8)


class InstanceNorm(nn.Module):
    """``nn.InstanceNorm2d``, which copies images that lie channels last and takes four times as long."""

    def __init__(self, channels: int) -> None:
        super().__init__()

    def forward(self, x: Float[Tensor, "M C H W"]) -> Float[Tensor, "M C H W"]:
        x = x - x.mean((2, 3), keepdim=True)
        return x * (x.square().mean((2, 3), keepdim=True) + 1e-5).rsqrt()


class Encoder(nn.Module):
    """Residual blocks down to an eighth of the size, 256 channels."""

    def __init__(self, norm: Callable[[int], nn.Module]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3)
        self.norm1 = norm(64)
        self.layer1 = nn.Sequential(ResidualBlock(64, 64, 1, norm), ResidualBlock(64, 64, 1, norm))
        self.layer2 = nn.Sequential(ResidualBlock(64, 96, 2, norm), ResidualBlock(96, 96, 1, norm))
        self.layer3 = nn.Sequential(ResidualBlock(96, 128, 2, norm), ResidualBlock(128, 128, 1, norm))
        self.conv2 = nn.Conv2d(128, 256, 1)

    def forward(self, x: Tensor) -> Tensor:
        x = F.relu(self.norm1(self.conv1(x)), inplace=True)
        return self.conv2(self.layer3(self.layer2(self.layer1(x))))


class ResidualBlock(nn.Module):
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
    """The parts of one step of the recurrence."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Motion()
        self.gru = Recurrent()
        first, last = nn.Conv2d(128, 256, 3, padding=1), nn.Conv2d(256, 2, 3, padding=1)
        self.flow_head = nn.Sequential(OrderedDict(conv1=first, relu=nn.ReLU(inplace=True), conv2=last))
        self.mask = nn.Sequential(nn.Conv2d(128, 256, 3, padding=1), nn.ReLU(), nn.Conv2d(256, 64 * 9, 1))


class Motion(nn.Module):
    """The motion encoder: correlations and flow in 128 channels, the last two the flow itself."""

    def __init__(self) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(LEVELS * WINDOW**2, 256, 1)
        self.convc2 = nn.Conv2d(256, 192, 3, padding=1)
        self.convf1 = nn.Conv2d(2, 128, 7, padding=3)
        self.convf2 = nn.Conv2d(128, 64, 3, padding=1)
        self.conv = nn.Conv2d(64 + 192, 128 - 2, 3, padding=1)

    def forward(self, correlation: Tensor, flow: Tensor) -> Tensor:
        correlation = self.convc2(self.convc1(correlation).relu_()).relu_()
        movement = self.convf2(self.convf1(flow).relu_()).relu_()
        return torch.cat([self.conv(torch.cat([correlation, movement], dim=1)).relu_(), flow], dim=1)


class Recurrent(nn.Module):
    """A gated recurrent unit that convolves along rows, then along columns."""

    def __init__(self) -> None:
        super().__init__()
        for half, kernel, padding in HALVES:
            for gate in "zrq":
                self.add_module(f"conv{gate}{half}", nn.Conv2d(384, 128, kernel, padding=padding))

    def prepare(self, context: Float[Tensor, "M 128 h w"]) -> list[Half]:
        """What all iterations share: convolutions are linear, so that their part over the context stays the same."""
        halves: list[Half] = []
        for half, _, padding in HALVES:
            weight, bias = (
                torch.cat([self.get_parameter(f"conv{gate}{half}.{leaf}") for gate in "zrq"])
                for leaf in ("weight", "bias")
            )
            known = F.conv2d(context, weight[:, 128:256], bias, padding=padding)
            rest = torch.cat([weight[:, :128], weight[:, 256:]], dim=1)  # of state and motion
            halves.append((rest[:256], rest[256:], known, padding))
        return halves

    def forward(self, state: Tensor, halves: Sequence[Half], motion: Tensor) -> Tensor:
        """The next hidden state."""
        for update_reset, proposal, known, padding in halves:
            inputs = torch.cat([state, motion], dim=1)
            gates = F.conv2d(inputs, update_reset, padding=padding).add_(known[:, :256]).sigmoid_()
            update, reset = gates.split(128, dim=1)
            inputs[:, :128] *= reset
            proposed = F.conv2d(inputs, proposal, padding=padding).add_(known[:, 256:]).tanh_()
            state = state.lerp(proposed, update)
        return state


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

    Coordinates are (x, y) in pixels of the finest level. A window's first axis is x, as in the published network.
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
