"""The dense prediction transformer's decoder (Ranftl et al., arXiv 2103.13413), as geometry networks use it."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NotRequired, TypedDict, Unpack

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.nn.tokens import real


def by_views(
    function: Callable[[slice], Float[Tensor, "B v *rest"]], views: int, chunk: int
) -> Float[Tensor, "B V *rest"]:
    """Compute ``function`` for ``chunk`` views at a time, into one preallocated tensor."""
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
    """Coordinates of a map's columns and rows in an image of half diagonal 1 and aspect width / height, in float64."""
    rows, columns = grid
    half = (aspect**2 + 1) ** 0.5
    x, y = aspect / half * (columns - 1) / columns, 1 / half * (rows - 1) / rows
    return (torch.linspace(-x, x, columns, dtype=torch.float64), torch.linspace(-y, y, rows, dtype=torch.float64))


def uv_waves(line: Float[Tensor, " n"], channels: int) -> Float[Tensor, "C n"]:
    """Sines, then cosines, of coordinates at falling frequencies, in float32; ``channels`` is even."""
    frequencies = 100.0 ** -(torch.arange(channels // 2, dtype=torch.float64) / (channels // 2))
    angles = frequencies[:, None] * line
    return torch.cat([angles.sin(), angles.cos()]).float()


def add_positions_(x: Float[Tensor, "M C h w"], aspect: float) -> Float[Tensor, "M C h w"]:
    """Add a tenth of the waves of x to the first half of the channels and of those of y to the second, in place.

    Channels are a multiple of 4; ``aspect`` is width over height of the image.
    """
    columns, rows = scaled_waves((x.shape[-2], x.shape[-1]), aspect, x.shape[1] // 2, x.device, x.dtype)
    x[:, : len(columns)].add_(columns)
    x[:, len(columns) :].add_(rows)
    return x


@lru_cache(maxsize=64)
def scaled_waves(
    size: tuple[int, int], aspect: float, channels: int, device: torch.device, dtype: torch.dtype
) -> tuple[Float[Tensor, "C 1 w"], Float[Tensor, "C h 1"]]:
    """A tenth of the waves of x and of y, kept: they depend on sizes alone, and take more kernels than a layer."""
    with real():
        columns, rows = (0.1 * uv_waves(line, channels).to(device, dtype) for line in uv_grid(size, aspect))
        return columns[:, None, :], rows[:, :, None]


class ResidualConv(nn.Module):
    """Two convolutions with a residual: the input, or the *rectified* input, as some published weights were trained."""

    def __init__(self, dim: int, *, rectified: bool) -> None:
        super().__init__()
        self.rectified = rectified
        self.conv1 = nn.Conv2d(dim, dim, 3, padding=1)
        self.conv2 = nn.Conv2d(dim, dim, 3, padding=1)

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M C h w"]:
        positive = F.relu(x)
        return self.conv2(F.relu_(self.conv1(positive))) + (positive if self.rectified else x)


class Fusion(nn.Module):
    """Add a finer level to the decoded map and upsample it."""

    def __init__(self, dim: int, *, takes_level: bool, rectified: bool) -> None:
        super().__init__()
        self.level = ResidualConv(dim, rectified=rectified) if takes_level else nn.Identity()
        self.refine = ResidualConv(dim, rectified=rectified)
        self.project = nn.Conv2d(dim, dim, 1)

    def forward(
        self, x: Float[Tensor, "M C h w"], level: Float[Tensor, "M C h w"] | None, size: tuple[int, int]
    ) -> Float[Tensor, "M C h2 w2"]:
        """Decode a level to ``size``."""
        x = x if level is None else x + self.level(level)
        # Published in the other order, which gives the same (bilinear weights sum to 1) at a higher cost.
        return resized(self.project(self.refine(x)), size)


class FusionChain(nn.ModuleList):
    """Fusions from the coarsest level to the finest.

    With ``cropped`` the coarsest map is doubled and cropped at the lower right where the next level is smaller, as it
    is by one where a grid is odd; otherwise it is resized to the next level.
    """

    def __init__(self, dim: int, *, rectified: bool, cropped: bool = False) -> None:
        super().__init__(Fusion(dim, takes_level=level < 3, rectified=rectified) for level in range(4))
        self.cropped = cropped

    def forward(self, maps: Sequence[Float[Tensor, "M C _ _"]]) -> Float[Tensor, "M C h w"]:
        """The decoded map at eight times the grid of patches, from maps of the levels, the finest first."""
        height, width = _size(maps[0])
        rows, columns = _size(maps[2])
        doubled = 2 * maps[3].shape[-2], 2 * maps[3].shape[-1]
        x = self[3](maps[3], None, doubled if self.cropped else (rows, columns))[..., :rows, :columns]
        x = self[2](x, maps[2], _size(maps[1]))
        x = self[1](x, maps[1], (height, width))
        return self[0](x, maps[0], (2 * height, 2 * width))


class DptTrunkOptions(TypedDict):
    """Options of a :class:`DptTrunk` that decoders built on it pass on."""

    dim: int | Sequence[int]
    channels: Sequence[int]
    normed: NotRequired[bool]
    rectified: NotRequired[bool]
    waves: NotRequired[bool]
    cropped: NotRequired[bool]


class DptTrunk(nn.Module):
    """Decodes four levels of patch tokens into a map at eight times the grid of patches.

    Args:
        dim: Channels of the tokens, or of each level's.
        features: Channels of the decoder, a multiple of 8.
        channels: Channels of the four levels, multiples of 4.
        normed: Whether tokens are normalised ahead of it, by :attr:`norm`.
        rectified: See :class:`ResidualConv`.
        waves: Whether positions are added to maps; see :func:`add_positions_`.
        cropped: See :class:`FusionChain`.
    """

    def __init__(
        self,
        *,
        dim: int | Sequence[int],
        features: int,
        channels: Sequence[int],
        normed: bool = True,
        rectified: bool = True,
        waves: bool = True,
        cropped: bool = False,
    ) -> None:
        super().__init__()
        if features % 8 or len(channels) != 4 or any(width % 4 for width in channels):
            given = f"a decoder of {features} features and levels of {list(channels)} channels"
            raise UserError(f"{given}; features must be a multiple of 8, and the four levels multiples of 4")
        dims = [dim] * 4 if isinstance(dim, int) else dim
        self.dim, self.waves = dims[-1], waves
        fine, medium, _, coarse = channels
        self.norm = nn.LayerNorm(self.dim) if normed else nn.Identity()
        # A 1x1 convolution, on tokens instead of a map: no transposed copy of many channels is needed.
        self.projects = nn.ModuleList(nn.Linear(*pair) for pair in zip(dims, channels, strict=True))
        self.resize = nn.ModuleList(
            [
                nn.ConvTranspose2d(fine, fine, 4, stride=4),
                nn.ConvTranspose2d(medium, medium, 2, stride=2),
                nn.Identity(),
                nn.Conv2d(coarse, coarse, 3, stride=2, padding=1),
            ]
        )
        self.reduce = nn.ModuleList(nn.Conv2d(width, features, 3, padding=1, bias=False) for width in channels)
        self.fusions = FusionChain(features, rectified=rectified, cropped=cropped)

    @property
    def dtype(self) -> torch.dtype:
        """The dtype of the parameters."""
        return next(self.parameters()).dtype

    def levels(
        self, tokens: Sequence[Float[Tensor, "M p C"]], grid: tuple[int, int], aspect: float
    ) -> list[Float[Tensor, "M D _ _"]]:
        """Maps of the four levels, the finest first, from normalised patch tokens of the taps, the earliest first."""
        maps: list[Tensor] = []
        for level, project, resize, reduce in zip(tokens, self.projects, self.resize, self.reduce, strict=True):
            # Tokens are a channels-last map: convolutions keep that format, and are faster for it.
            small = project(level).unflatten(1, grid).movedim(-1, 1)
            maps.append(reduce(resize(add_positions_(small, aspect) if self.waves else small)))
        return maps


class Dpt(DptTrunk):
    """Decodes four levels of patch tokens into a map at the image's size.

    Args:
        features: Channels of the decoder, a multiple of 8; at full size they are half.
        hidden: Channels of the last hidden layer.
        outputs: Channels of the result.
        options: Those of :class:`DptTrunk`.
    """

    def __init__(self, *, features: int, hidden: int, outputs: int, **options: Unpack[DptTrunkOptions]) -> None:
        super().__init__(features=features, **options)
        self.width = features // 2
        self.neck = nn.Conv2d(features, features // 2, 3, padding=1)
        self.output = nn.Sequential(
            nn.Conv2d(features // 2, hidden, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(hidden, outputs, 1)
        )

    def decode(
        self, levels: Sequence[Float[Tensor, "M p C"]], grid: tuple[int, int], size: tuple[int, int]
    ) -> Float[Tensor, "M E H W"]:
        """A map of ``features / 2`` channels at the image's size from normalised patch tokens, as :meth:`levels`."""
        return resized(self.neck(self.fusions(self.levels(levels, grid, size[1] / size[0]))), size)

    def predict_(self, x: Float[Tensor, "M E H W"]) -> Float[Tensor, "M H W F"]:
        """The result from a decoded map, which is overwritten."""
        return self.output(add_positions_(x, x.shape[-1] / x.shape[-2]) if self.waves else x).movedim(1, -1)


def _size(x: Float[Tensor, "M C h w"]) -> tuple[int, int]:
    return x.shape[-2], x.shape[-1]


def resized(x: Float[Tensor, "M C h w"], size: tuple[int, int]) -> Float[Tensor, "M C h2 w2"]:
    """Maps brought to a size; corners stay corners."""
    return F.interpolate(x, size=size, mode="bilinear", align_corners=True)
