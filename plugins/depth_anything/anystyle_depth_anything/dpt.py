"""The dense prediction transformer's decoder, as Depth Anything 3 uses it: single, and with two chains."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

HIDDEN = 32
"""Channels of the last hidden layer, in every size."""


def by_views(
    function: Callable[[slice], Float[Tensor, "B v *rest"]], views: int, chunk: int
) -> Float[Tensor, "B V *rest"]:
    """Compute ``function`` for ``chunk`` views at a time and join the results."""
    parts = [function(slice(start, start + chunk)) for start in range(0, views, chunk)]
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)


def uv_waves(count: int, extent: float, channels: int) -> Float[Tensor, "C n"]:
    """Sines, then cosines, of the places of a map's rows or columns, at falling frequencies, in float32.

    Args:
        count: Rows or columns.
        extent: The image's height or width over its diagonal.
        channels: Even.
    """
    edge = extent * (count - 1) / count
    line = torch.linspace(-edge, edge, count, dtype=torch.float64)
    frequencies = 100.0 ** -(torch.arange(channels // 2, dtype=torch.float64) / (channels // 2))
    angles = frequencies[:, None] * line
    return torch.cat([angles.sin(), angles.cos()]).float()


def add_positions(x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M C h w"]:
    """Add a tenth of the waves of x to the first half of the channels, and of those of y to the second.

    Each half depends on one coordinate, so no embedding of the map's size is ever held.

    Args:
        x: A map in the aspect of its image, whose channels are a multiple of 4.
    """
    half = x.shape[1] // 2
    height, width = x.shape[-2:]
    diagonal = (height**2 + width**2) ** 0.5
    columns = 0.1 * uv_waves(width, width / diagonal, half).to(x)
    rows = 0.1 * uv_waves(height, height / diagonal, half).to(x)
    return torch.cat([x[:, :half] + columns[:, None, :], x[:, half:] + rows[:, :, None]], dim=1)


class ResidualConv(nn.Module):
    """Two convolutions around which passes the input."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(dim, dim, 3, padding=1)
        self.conv2 = nn.Conv2d(dim, dim, 3, padding=1)

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M C h w"]:
        """Refine a map."""
        return self.conv2(F.relu(self.conv1(F.relu(x)))) + x


class Fusion(nn.Module):
    """Takes a finer level into the decoded map and enlarges it."""

    def __init__(self, dim: int, *, takes_level: bool) -> None:
        super().__init__()
        self.level = ResidualConv(dim) if takes_level else nn.Identity()
        self.refine = ResidualConv(dim)
        self.project = nn.Conv2d(dim, dim, 1)

    def forward(
        self, x: Float[Tensor, "M C h w"], level: Float[Tensor, "M C h w"] | None, size: tuple[int, int]
    ) -> Float[Tensor, "M C h2 w2"]:
        """Decode a level to ``size``."""
        x = x if level is None else x + self.level(level)
        # Published the other way round; bilinear weights sum to 1, so the order does not matter, but the cost does.
        return resized(self.project(self.refine(x)), size)


class Chain(nn.ModuleList):
    """Fusions from the coarsest level to the finest.

    Args:
        dim: Channels.
    """

    def __init__(self, dim: int) -> None:
        super().__init__(Fusion(dim, takes_level=level < 3) for level in range(4))

    def forward(self, maps: Sequence[Float[Tensor, "M C _ _"]]) -> Float[Tensor, "M C h w"]:
        """The decoded map at eight times the grid of patches, from maps of the levels, the finest first."""
        height, width = _size(maps[0])
        x = self[3](maps[3], None, _size(maps[2]))
        x = self[2](x, maps[2], _size(maps[1]))
        x = self[1](x, maps[1], (height, width))
        return self[0](x, maps[0], (2 * height, 2 * width))


class Dpt(nn.Module):
    """Decodes four levels of patch tokens into a map at the image's size.

    Args:
        dim: Channels of the tokens.
        features: Channels of the decoder, a multiple of 8; at full size they are half.
        channels: Channels of the levels, multiples of 4.
        outputs: Channels of the result.
    """

    def __init__(self, *, dim: int, features: int, channels: Sequence[int], outputs: int) -> None:
        super().__init__()
        fine, medium, _, coarse = channels
        # A 1x1 convolution, on tokens instead of a map: no transposed copy of many channels is needed.
        self.projects = nn.ModuleList(nn.Linear(dim, width) for width in channels)
        self.resize = nn.ModuleList(
            [
                nn.ConvTranspose2d(fine, fine, 4, stride=4),
                nn.ConvTranspose2d(medium, medium, 2, stride=2),
                nn.Identity(),
                nn.Conv2d(coarse, coarse, 3, stride=2, padding=1),
            ]
        )
        self.reduce = nn.ModuleList(nn.Conv2d(width, features, 3, padding=1, bias=False) for width in channels)
        self.fusions = Chain(features)
        self.neck = nn.Conv2d(features, features // 2, 3, padding=1)
        self.output = nn.Sequential(
            nn.Conv2d(features // 2, HIDDEN, 3, padding=1), nn.ReLU(), nn.Conv2d(HIDDEN, outputs, 1)
        )

    def levels(self, tokens: Sequence[Float[Tensor, "M p C"]], grid: tuple[int, int]) -> list[Tensor]:
        """Maps of the four levels, the finest first, from patch tokens of the earliest tap to the last."""
        maps = []
        for level, project, resize, reduce in zip(tokens, self.projects, self.resize, self.reduce, strict=True):
            small = project(level).mT.unflatten(2, grid)
            maps.append(reduce(resize(add_positions(small))))
        return maps

    def decode(self, maps: Sequence[Float[Tensor, "M C _ _"]], size: tuple[int, int]) -> Float[Tensor, "M E H W"]:
        """A map of ``features / 2`` channels at the image's size."""
        return resized(self.neck(self.fusions(maps)), size)

    def predict(self, x: Float[Tensor, "M E H W"]) -> Float[Tensor, "M F H W"]:
        """The result from a decoded map."""
        return self.output(add_positions(x))


class RayChain(nn.Module):
    """The second chain, which tells the ray of every place on a grid eight times as fine as the patches.

    Args:
        features: Channels of the decoder.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        wide, narrow = features, features // 2
        self.fusions = Chain(wide)
        self.neck = nn.Sequential(
            *(nn.Conv2d(a, b, 3, padding=1) for a, b in [(wide, narrow), (narrow, wide)] * 2 + [(wide, narrow)])
        )
        self.first = nn.Conv2d(narrow, HIDDEN, 3, padding=1)
        self.norm = nn.LayerNorm(HIDDEN)
        self.last = nn.Conv2d(HIDDEN, 7, 1)

    def forward(self, maps: Sequence[Float[Tensor, "M C _ _"]]) -> Float[Tensor, "M 7 h w"]:
        """Direction and origin of rays, and the logarithm of confidence less one."""
        x = self.first(add_positions(self.neck(self.fusions(maps))))
        return self.last(F.relu(self.norm(x.movedim(1, -1)).movedim(-1, 1)))


def resized(x: Float[Tensor, "M C h w"], size: tuple[int, int]) -> Float[Tensor, "M C h2 w2"]:
    """A map at another size, corners on corners."""
    return F.interpolate(x, size=size, mode="bilinear", align_corners=True)


def _size(x: Float[Tensor, "M C h w"]) -> tuple[int, int]:
    return x.shape[-2], x.shape[-1]
