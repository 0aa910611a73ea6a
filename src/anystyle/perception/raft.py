"""RAFT, the recurrent network of optical flow (Teed and Deng, ECCV 2020), in its large form.

Two published layouts load into it: the original ``raft-things.pth`` and torchvision's ``raft_large``. Only what differs
between iterations is computed in each: what the update reads of the context is computed once, and the mask of the
upsampling after the last.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception import lines, weights
from anystyle.perception.correlations import LEVELS, WINDOW, correlations, look_up
from anystyle.perception.features import Frozen, fold, load_strictly
from anystyle.perception.winograd import quicken, suits

SMALLEST = 128
"""Below this many pixels a side the coarsest level of correlations is one pixel wide, and the flow is not a number."""


STATE, CONTEXT, MOTION = slice(0, 128), slice(128, 256), slice(256, 384)
"""What the channels are that the recurrent unit reads."""

PADDING = {1: (0, 2), 2: (2, 0)}
"""Of its halves, the first along rows, the second along columns."""


class Context(NamedTuple):
    """What a source frame alone decides.

    Args:
        state: The first hidden state.
        reading: What every gate reads of the context, for both halves of the recurrent unit.
    """

    state: Float[Tensor, "M 128 h w"]
    reading: Float[Tensor, "M 768 h w"]


class Raft(Frozen):
    """RAFT large, 5.26 M parameters, under the keys of the original file without its prefix."""

    def __init__(self) -> None:
        super().__init__()
        self.fnet = Encoder(InstanceNorm)
        self.cnet = Encoder(nn.BatchNorm2d)
        self.update_block = Update()

    def settle(self) -> None:
        """See :meth:`anystyle.perception.features.Frozen.settle`: normalisations become part of convolutions."""
        self.cnet.fold()
        self.update_block.gru.settle()

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 256 h w"]:
        """What frames are matched by, at an eighth of the size.

        Args:
            images: sRGB in [0, 1]; sides are multiples of 8, at least 128.
        """
        return self.fnet(2 * images - 1)

    def context(self, images: Float[Tensor, "M 3 H W"]) -> Context:
        """What steers the flow from these frames."""
        state, reading = self.cnet(2 * images - 1).split(128, dim=1)
        return Context(state.tanh(), self.update_block.gru.read(F.relu(reading)))

    def flow(
        self,
        source: Float[Tensor, "M 256 h w"],
        target: Float[Tensor, "M 256 h w"],
        context: Context,
        iterations: int = 32,
    ) -> Float[Tensor, "M 2 H W"]:
        """The flow, (x, y) in pixels, pair by pair.

        Args:
            source: Of :meth:`describe`.
            target: Of :meth:`describe`.
            context: Of the source.
            iterations: Of the update.
        """
        pyramid = correlations(source, target)
        # What is looked up lies channel beside channel; so does all that it meets.
        start, state, *reading = (
            tensor.contiguous(memory_format=torch.channels_last)
            for tensor in (_grid(source), context.state, *context.reading.split(384, dim=1))
        )
        place = start
        for _ in range(iterations):
            state, step = self.update_block(state, reading, look_up(pyramid, place), place - start)
            place = place + step
        return upsample(place - start, self.update_block.weights_of(state))

    def forward(
        self, source: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"], iterations: int = 32
    ) -> Float[Tensor, "M 2 H W"]:
        """The flow between sRGB images in [0, 1] whose sides are multiples of 8, at least 128.

        Raises:
            ValueError: The sides are others.
        """
        height, width = source.shape[-2:]
        if min(height, width) < SMALLEST or height % 8 or width % 8:
            raise ValueError(
                f"RAFT got frames of {height}x{width} pixels; sides are multiples of 8, at least {SMALLEST}: pad them"
            )
        features = self.describe(torch.cat([source, target]))
        first, second = features.chunk(2)
        return self.flow(first, second, self.context(source), iterations)


def load(name: str = "raft_things", path: str | Path | None = None) -> Raft:
    """The network with published weights, of either layout.

    Args:
        name: ``raft_things`` or ``raft_large``.
        path: The file, if not where :func:`anystyle.perception.weights.find` looks.

    Raises:
        ValueError: The file does not hold its weights.
        FileNotFoundError: They are missing.
    """
    file = weights.find(name, path)
    return quicken(load_strictly(Raft(), own_keys(weights.read(file)), name=name, file=file))


def own_keys(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A published state dict under this module's keys; unknown keys stay as they are."""
    state = {key.removeprefix("module."): tensor for key, tensor in state.items()}
    if any(key.startswith("feature_encoder.") for key in state):
        return {_from_torchvision(key): tensor for key, tensor in state.items()}
    # One module of the original has two names; the other is `downsample.1`.
    return {
        key: tensor
        for key, tensor in state.items()
        if not (key.startswith("cnet.layer") and ".norm3." in key and _other_name(key) in state)
    }


def _other_name(key: str) -> str:
    return key.replace(".norm3.", ".downsample.1.")


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
    """To eight times the size: each new pixel is a convex combination of the nine old ones around it."""
    count, _, height, width = flow.shape
    share = logits.permute(0, 2, 3, 1).reshape(count, height * width, 9, 64).softmax(dim=2)
    around = F.unfold(8 * flow, 3, padding=1).reshape(count, 2, 9, height * width).permute(0, 3, 2, 1)
    fine = share.new_zeros(count, height * width, 2, 64)
    for neighbour in range(9):
        fine = fine + around[:, :, neighbour, :, None] * share[:, :, neighbour, None]
    fine = fine.reshape(count, height, width, 2, 8, 8)
    return fine.permute(0, 3, 1, 4, 2, 5).reshape(count, 2, 8 * height, 8 * width)


def _grid(like: Float[Tensor, "M C h w"]) -> Float[Tensor, "M 2 h w"]:
    height, width = like.shape[-2:]
    y = torch.arange(height, dtype=like.dtype, device=like.device)
    x = torch.arange(width, dtype=like.dtype, device=like.device)
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y]).expand(like.shape[0], -1, -1, -1)


class InstanceNorm(nn.Module):
    """PyTorch's, but for the copies that it makes of images whose channels lie side by side."""

    def __init__(self, channels: int) -> None:
        super().__init__()

    def forward(self, x: Float[Tensor, "M C H W"]) -> Float[Tensor, "M C H W"]:
        """Each channel of each image with mean 0 and variance 1."""
        x = x - x.mean((2, 3), keepdim=True)
        return x * (x.square().mean((2, 3), keepdim=True) + 1e-5).rsqrt()


class Encoder(nn.Module):
    """Residual blocks down to an eighth of the size."""

    def __init__(self, norm: Callable[[int], nn.Module]) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3)
        self.norm1 = norm(64)
        self.layer1 = nn.Sequential(Residual(64, 64, 1, norm), Residual(64, 64, 1, norm))
        self.layer2 = nn.Sequential(Residual(64, 96, 2, norm), Residual(96, 96, 1, norm))
        self.layer3 = nn.Sequential(Residual(96, 128, 2, norm), Residual(128, 128, 1, norm))
        self.conv2 = nn.Conv2d(128, 256, 1)

    def fold(self) -> None:
        """Make normalisations part of the convolutions before them."""
        self.norm1 = fold(self.conv1, self.norm1)
        for module in self.modules():
            if isinstance(module, Residual):
                module.fold()

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

    def fold(self) -> None:
        """Make normalisations part of the convolutions before them."""
        self.norm1, self.norm2 = fold(self.conv1, self.norm1), fold(self.conv2, self.norm2)
        if len(self.downsample):
            conv, norm = self.downsample
            self.downsample[1] = fold(conv, norm)  # pyright: ignore[reportArgumentType]

    def forward(self, x: Tensor) -> Tensor:
        """The sum of both ways, rectified."""
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

    def forward(self, state: Tensor, reading: Sequence[Tensor], found: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """The next hidden state, and how the flow changes."""
        state = self.gru(state, reading, self.encoder(found, flow))
        return state, self.flow_head(state)

    def weights_of(self, state: Float[Tensor, "M 128 h w"]) -> Float[Tensor, "M 576 h w"]:
        """Logits of the upsampling's weights; a quarter, as published, to balance gradients."""
        return self.mask(state).mul_(0.25)


class Motion(nn.Module):
    """What correlations and flow say together."""

    def __init__(self) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(LEVELS * WINDOW**2, 256, 1)
        self.convc2 = nn.Conv2d(256, 192, 3, padding=1)
        self.convf1 = nn.Conv2d(2, 128, 7, padding=3)
        self.convf2 = nn.Conv2d(128, 64, 3, padding=1)
        self.conv = nn.Conv2d(64 + 192, 128 - 2, 3, padding=1)

    def forward(self, found: Tensor, flow: Tensor) -> Tensor:
        """128 channels, the last two the flow itself."""
        correlation = self.convc2(self.convc1(found).relu_()).relu_()
        movement = self.convf2(self.convf1(flow).relu_()).relu_()
        return torch.cat([self.conv(torch.cat([correlation, movement], dim=1)).relu_(), flow], dim=1)


class Recurrent(nn.Module):
    """A gated recurrent unit that looks along rows, then along columns.

    Its convolutions are linear: what they read of the context is the same in every iteration and computed once.
    """

    def __init__(self) -> None:
        super().__init__()
        for half, kernel in ((1, (1, 5)), (2, (5, 1))):
            for gate in "zrq":
                self.add_module(f"conv{gate}{half}", nn.Conv2d(384, 128, kernel, padding=PADDING[half]))

    def settle(self) -> None:
        """Compute what convolutions along lines need of the weights."""
        for half in (1, 2):
            for gates in ("zr", "q"):
                values = lines.values_of(self._weight(half, gates, STATE, MOTION).flatten(2))
                self.register_buffer(f"values_{gates}{half}", values, persistent=False)

    def read(self, context: Float[Tensor, "M 128 h w"]) -> Float[Tensor, "M 768 h w"]:
        """What the three gates of both halves read of the context, biases included."""
        found = []
        for half in (1, 2):
            bias = torch.cat([self.get_parameter(f"conv{gate}{half}.bias") for gate in "zrq"])
            found.append(F.conv2d(context, self._weight(half, "zrq", CONTEXT), bias, padding=PADDING[half]))
        return torch.cat(found, dim=1)

    def forward(self, state: Tensor, reading: Sequence[Tensor], motion: Tensor) -> Tensor:
        """The next hidden state; what was read of the context is given for each half."""
        for half, known in zip((1, 2), reading, strict=True):
            gates = self._convolve(half, "zr", torch.cat([state, motion], dim=1)).add_(known[:, :256])
            update, reset = gates.sigmoid_().split(128, dim=1)
            proposed = self._convolve(half, "q", torch.cat([reset * state, motion], dim=1)).add_(known[:, 256:])
            state = state.lerp(proposed.tanh_(), update)
        return state

    def _convolve(self, half: int, gates: str, x: Float[Tensor, "M 256 h w"]) -> Tensor:
        values = getattr(self, f"values_{gates}{half}", None)
        if values is not None and suits(x, values):
            return lines.convolve(x, values, axis=4 - half)
        return F.conv2d(x, self._weight(half, gates, STATE, MOTION), padding=PADDING[half])

    def _weight(self, half: int, gates: str, *channels: slice) -> Tensor:
        """Of some gates, what reads these channels."""
        every = [self.get_parameter(f"conv{gate}{half}.weight") for gate in gates]
        return torch.cat([torch.cat([weight[:, some] for some in channels], dim=1) for weight in every])


class Head(nn.Module):
    """The change of the flow."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(128, 256, 3, padding=1)
        self.conv2 = nn.Conv2d(256, 2, 3, padding=1)

    def forward(self, state: Tensor) -> Tensor:
        """(x, y) in pixels of an eighth of the size."""
        return self.conv2(self.conv1(state).relu_())
