"""360° photographs: which photographs are some, and the pinhole views that they are cut into.

A panorama here is equirectangular, as 360° cameras stitch it: columns are longitudes and rows latitudes. Its frame has
OpenCV's axes, with z through its middle. The views are a rig: known rotations about one centre, and one known lens.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sqrt

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Float64
from PIL import Image
from scipy.spatial.transform import Rotation
from torch import Tensor

from anystyle.data.images import panorama_tag
from anystyle.errors import UserError, listing
from anystyle.types import Original

logger = logging.getLogger(__name__)
AROUND, FEWEST, MOST = 6, 4, 24
"""Views around the horizon, and the bounds of what can be asked for."""
ROWS = 1 << 18
"""Pixels that are cut at once."""
HEIGHT = 256
"""Rows at which a picture is looked at for its seam."""
CLOSED, APART, EVEN, VARIED = 1.6, 2.0, 0.1, 0.4
"""The columns of a panorama beside its seam differ by at most this ratio of what other neighbours do, and opposite ones
by this one more. The row of a pole spreads by at most this fraction of others, a column at the seam by this of all."""


@dataclass(frozen=True)
class Cut:
    """Square views of a panorama: ``around`` at its horizon, in equal steps to the right, and one upwards."""

    around: int = AROUND

    def __post_init__(self) -> None:
        if not FEWEST <= self.around <= MOST:
            told = f"views.panorama={self.around}: a panorama is cut into {FEWEST} to {MOST} views around the horizon"
            raise UserError(f"{told}, and 0 takes photographs for what ordinary cameras take")

    @cached_property
    def slope(self) -> float:
        """Tangent of half the field of view, the smallest that leaves no gap to the view upwards."""
        return 1 / sqrt(cos(pi / self.around))

    @property
    def degrees(self) -> float:
        """Field of view."""
        return float(2 * np.degrees(np.arctan(self.slope)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the views: degrees to the right, and ``up``, in the middle for sheets to begin and end at the horizon."""
        names = [f"{360 * index / self.around:03.0f}" for index in range(self.around)]
        return (*names[: self.around // 2], "up", *names[self.around // 2 :])

    @cached_property
    def panorama_from_view(self) -> Float64[np.ndarray, "N 3 3"]:
        """Rotations; the first is the identity."""
        turns = np.outer(2 * pi / self.around * np.arange(self.around), [0, 1, 0])
        return Rotation.from_rotvec(np.insert(turns, self.around // 2, [pi / 2, 0, 0], axis=0)).as_matrix()

    def side(self, width: int) -> int:
        """Of views with the resolution that a panorama of this width has at its horizon."""
        return round(self.slope * width / pi)

    def focal(self, side: int) -> float:
        """In pixels of a view of this side."""
        return side / (2 * self.slope)

    def intrinsics(self, side: int) -> Float64[np.ndarray, "3 3"]:
        """Of a view of this side."""
        return np.array([[self.focal(side), 0, side / 2], [0, self.focal(side), side / 2], [0, 0, 1.0]])

    def view(self, index: int, panorama: Image.Image) -> Image.Image:
        """A view of a panorama, such as a photograph or its mask, at the panorama's resolution."""
        side = self.side(panorama.width)
        image = around_the_edges(torch.from_numpy(np.array(panorama.convert("RGB"))).permute(2, 0, 1))
        steps = (torch.arange(side, dtype=torch.float64) + 0.5) / self.focal(side) - self.slope
        rotation, rows = torch.from_numpy(self.panorama_from_view[index]), max(1, ROWS // side)
        parts = []
        for some in steps.split(rows):
            y, x = torch.meshgrid(some, steps, indexing="ij")
            rays = torch.stack([x, y, torch.ones_like(x)], -1) @ rotation.T
            parts.append(sampled(image, pixels_of_rays(rays, panorama.width, panorama.height)))
        return Image.fromarray(torch.cat(parts, dim=1).permute(1, 2, 0).numpy())


def pixels_of_rays(rays: Float64[Tensor, "*N 3"], width: int, height: int) -> Float64[Tensor, "*N 2"]:
    """Where a panorama shows rays of its frame: column and row, (0.5, 0.5) in the middle of the first pixel."""
    x, y, z = rays.unbind(-1)
    longitude, latitude = torch.atan2(x, z), torch.atan2(-y, torch.hypot(x, z))
    return torch.stack([(longitude / (2 * pi) + 0.5) * width, (0.5 - latitude / pi) * height], dim=-1)


EDGE = 3
"""Pixels that a panorama goes on beyond its edges, for windows of interpolation to lie in it."""


def around_the_edges(image: Float[Tensor, "C H W"]) -> Float[Tensor, "C H+6 W+6"]:
    """A panorama that goes on beyond its sides, which meet, and beyond its poles, half a turn on."""
    over = image.roll(image.shape[-1] // 2, -1)
    tall = torch.cat([over[:, :EDGE].flip(1), image, over[:, -EDGE:].flip(1)], dim=1)
    return torch.cat([tall[..., -EDGE:], tall, tall[..., :EDGE]], dim=-1)


def sampled(image: Tensor, pixels: Float64[Tensor, "H W 2"]) -> Tensor:
    """Values of a panorama :func:`around_the_edges` at pixels of it, by cubic interpolation, as 8-bit numbers."""
    # Only the part that the pixels lie in becomes floating-point numbers.
    low, high = (pixels.amin((0, 1)).floor().long()).tolist(), (pixels.amax((0, 1)).floor().long()).tolist()
    part = image[:, low[1] : high[1] + 2 * EDGE + 1, low[0] : high[0] + 2 * EDGE + 1].float()
    size = pixels.new_tensor([part.shape[2], part.shape[1]])
    grid = 2 * (pixels + EDGE - pixels.new_tensor(low)) / size - 1
    found = F.grid_sample(part[None], grid.float()[None], mode="bicubic", padding_mode="border", align_corners=False)
    return found[0].clamp(0, 255).round().byte()


def closes(picture: Image.Image) -> bool:
    """Whether a picture twice as wide as high looks like a panorama.

    Its sides meet, at a seam that shows something; its halves differ; and the row at one of its poles shows one point.
    """
    gray = np.asarray(picture.convert("L").resize((2 * HEIGHT, HEIGHT), Image.Resampling.BOX), dtype=np.float64)
    steps = np.abs(np.diff(gray, axis=1, append=gray[:, :1])).mean(0)
    opposite, rows = np.abs(gray - np.roll(gray, HEIGHT, axis=1)).mean(), gray.std(1)
    meets = steps[-1] <= CLOSED * max(steps[0], steps[-2], np.median(steps)) and opposite >= APART * steps[-1]
    shows = gray[:, [0, -1]].std(0).min() >= VARIED * gray.std() > 0
    return bool(meets and shows and min(rows[0], rows[-1]) <= EVEN * np.median(rows))


def cut_of(originals: Sequence[Original]) -> tuple[Cut | None, Sequence[Original]]:
    """How photographs are cut if they are panoramas, and those that are read: of two kinds, the more frequent one.

    Photographs twice as wide as high are panoramas if most of these have the tag of one or look like one, or if a
    number of views is asked for.
    """
    wide = [one for one in originals if one.panorama != 0 and one.size[1] == 2 * one.size[0]]
    if originals[0].panorama and not wide:
        raise UserError(f"views.panorama={originals[0].panorama}: no photograph is twice as wide as high")
    known = [one for one in wide if one.panorama or (one.path and panorama_tag(one.path)) or closes(one.picture)]
    if 2 * len(known) <= max(len(wide), len(originals) - len(wide)):
        return None, originals
    cut, left = Cut(wide[0].panorama or AROUND), [one.name for one in originals if one not in wide]
    if left:
        logger.warning("photographs among panoramas are left out: %s", listing(left))
    size = cut.side(max(one.picture.width for one in wide))
    told = "%d panoramas are cut into %d views of up to %d x %d pixels, %.0f° each; what lies below -%.0f° is left out"
    logger.warning(told, len(wide), len(wide) * len(cut.names), size, size, cut.degrees, cut.degrees / 2)
    logger.warning("views.panorama=8 cuts each into more views, views.panorama=0 takes them for ordinary photographs")
    return cut, wide
