"""The dense prediction transformer's decoder, as VGGT and AnySplat use it."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


def by_views(
    function: Callable[[slice], Float[Tensor, "B v *rest"]], views: int, chunk: int
) -> Float[Tensor, "B V *rest"]:
    """Compute ``function`` for ``chunk`` views at a time and join the results.

    The results go into one tensor as they come, so that no second copy of them is ever held.
    """
    first = function(slice(0, chunk))
    if chunk >= views:
        return first
    joined = first.new_empty(first.shape[0], views, *first.shape[2:])
    joined[:, :chunk] = first
    del first
    for start in range(chunk, views, chunk):
        joined[:, start : start + chunk] = function(slice(start, start + chunk))
    return joined


def uv_grid(grid: tuple[int, int], aspect: float) -> tuple[Float[Tensor, " w"], Float[Tensor, " h"]]:
    """Where a map's columns and rows lie in an image whose half diagonal is 1, in float64.

    Args:
        grid: Rows and columns of the map.
        aspect: Width over height of the image.
    """
    rows, columns = grid
    half = (aspect**2 + 1) ** 0.5
    x, y = aspect / half * (columns - 1) / columns, 1 / half * (rows - 1) / rows
    return (
        torch.linspace(-x, x, columns, dtype=torch.float64),
        torch.linspace(-y, y, rows, dtype=torch.float64),
    )


def uv_waves(line: Float[Tensor, " n"], channels: int) -> Float[Tensor, "C n"]:
    """Sines, then cosines, of a line's coordinates at falling frequencies, in float32.

    Args:
        line: Of :func:`uv_grid`.
        channels: Even.
    """
    frequencies = 100.0 ** -(torch.arange(channels // 2, dtype=torch.float64) / (channels // 2))
    angles = frequencies[:, None] * line
    return torch.cat([angles.sin(), angles.cos()]).float()


def add_positions_(x: Float[Tensor, "M C h w"], aspect: float) -> Float[Tensor, "M C h w"]:
    """Add a tenth of the waves of x to the first half of the channels and of those of y to the second, in place.

    Each half depends on one coordinate, so no embedding of the map's size is ever held.

    Args:
        x: A map whose channels are a multiple of 4.
        aspect: Width over height of the image.
    """
    half = x.shape[1] // 2
    columns, rows = (0.1 * uv_waves(line, half).to(x) for line in uv_grid((x.shape[-2], x.shape[-1]), aspect))
    x[:, :half] += columns[:, None, :]
    x[:, half:] += rows[:, :, None]
    return x


class ResidualConv(nn.Module):
    """Two convolutions around which passes the *rectified* input: the published weights were trained that way."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(dim, dim, 3, padding=1)
        self.conv2 = nn.Conv2d(dim, dim, 3, padding=1)

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M C h w"]:
        """Refine a map."""
        x = F.relu(x)
        return self.conv2(F.relu_(self.conv1(x))) + x


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
        return _resize(self.project(self.refine(x)), size)


class Dpt(nn.Module):
    """Decodes four levels of patch tokens into a map at the image's size.

    Args:
        dim: Channels of the tokens.
        features: Channels of the decoder, a multiple of 8; at full size they are half.
        channels: Channels of the levels, multiples of 4.
        hidden: Channels of the last hidden layer.
        outputs: Channels of the result.
    """

    def __init__(self, *, dim: int, features: int, channels: Sequence[int], hidden: int, outputs: int) -> None:
        super().__init__()
        fine, medium, _, coarse = channels
        self.norm = nn.LayerNorm(dim)
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
        self.fusions = nn.ModuleList(Fusion(features, takes_level=level < 3) for level in range(4))
        self.neck = nn.Conv2d(features, features // 2, 3, padding=1)
        self.output = nn.Sequential(
            nn.Conv2d(features // 2, hidden, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(hidden, outputs, 1)
        )

    def decode(
        self, levels: Sequence[Float[Tensor, "M p C"]], grid: tuple[int, int], size: tuple[int, int]
    ) -> Float[Tensor, "M E H W"]:
        """A map of ``features / 2`` channels from normalised patch tokens.

        Args:
            levels: Patch tokens after :attr:`norm`, from the earliest tap to the last.
            grid: Their rows and columns.
            size: Height and width of the image.
        """
        aspect = size[1] / size[0]
        maps = []
        for tokens, project, resize, reduce in zip(levels, self.projects, self.resize, self.reduce, strict=True):
            # Tokens are a map whose channels lie side by side: convolutions keep that order, and are faster for it.
            small = project(tokens).unflatten(1, grid).movedim(-1, 1)
            maps.append(reduce(resize(add_positions_(small, aspect))))
        x = self.fusions[3](maps[3], None, _size(maps[2]))
        x = self.fusions[2](x, maps[2], _size(maps[1]))
        x = self.fusions[1](x, maps[1], _size(maps[0]))
        height, width = _size(maps[0])
        x = self.fusions[0](x, maps[0], (2 * height, 2 * width))
        return _resize(self.neck(x), size)

    def predict_(self, x: Float[Tensor, "M E H W"]) -> Float[Tensor, "M H W F"]:
        """The result from a decoded map, which is overwritten."""
        return self.output(add_positions_(x, x.shape[-1] / x.shape[-2])).movedim(1, -1)


def _size(x: Float[Tensor, "M C h w"]) -> tuple[int, int]:
    return x.shape[-2], x.shape[-1]


def _resize(x: Float[Tensor, "M C h w"], size: tuple[int, int]) -> Float[Tensor, "M C h2 w2"]:
    return F.interpolate(x, size=size, mode="bilinear", align_corners=True)
