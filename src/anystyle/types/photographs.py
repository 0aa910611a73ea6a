"""Photographs as they were taken, and what views show of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxtyping import Float
from PIL import Image
from torch import Tensor


@dataclass(frozen=True)
class SourceImage:
    """Where a view comes from, and what part of the source it shows.

    Sizes are height and width in pixels.
    """

    name: str  # of the file without suffix, or of the video with the frame's number
    size: tuple[int, int]  # of the upright source
    box: tuple[float, float, float, float]  # left, top, right and bottom of what the view shows, in source pixels
    view_size: tuple[int, int]
    path: Path | None = None  # where the source is an image file
    straightened: Callable[[Image.Image], Image.Image] | None = None
    """Undistorts an upright picture of the source, at any resolution, where the source was undistorted."""

    def of_view(self, picture: Image.Image) -> Image.Image:
        """What the view shows of an upright picture of the source, such as a mask, at any resolution."""
        straight = picture if self.straightened is None else self.straightened(picture)
        x, y = straight.width / self.size[1], straight.height / self.size[0]
        left, top, right, bottom = self.box
        size = (self.view_size[1], self.view_size[0])
        # Rounding may put the box a little outside of the picture, which the resampling refuses.
        box = (left * x, top * y, min(right * x, straight.width), min(bottom * y, straight.height))
        return straight.resize(size, box=box)

    def source_intrinsics(self, intrinsics: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
        """Intrinsics in pixels of the view as intrinsics in pixels of the source."""
        left, top, right, bottom = self.box
        x, y = (right - left) / self.view_size[1], (bottom - top) / self.view_size[0]
        return intrinsics.new_tensor([[x, 0.0, left], [0.0, y, top], [0.0, 0.0, 1.0]]) @ intrinsics

    def view_intrinsics(self, intrinsics: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
        """Intrinsics in pixels of the source as intrinsics in pixels of the view."""
        left, top, right, bottom = self.box
        x, y = self.view_size[1] / (right - left), self.view_size[0] / (bottom - top)
        return intrinsics.new_tensor([[x, 0.0, -left * x], [0.0, y, -top * y], [0.0, 0.0, 1.0]]) @ intrinsics


class Original(NamedTuple):
    """A photograph as it was taken, upright and maybe reduced, under a distinct name.

    The size is the source's height and width in pixels; frames of videos have no path, and of EXIF data their lens's.
    The mask, of the picture's size, is black where it does not count, such as where it is transparent.
    """

    name: str
    path: Path | None
    size: tuple[int, int]
    picture: Image.Image
    exif: Image.Exif
    mask: Image.Image | None = None
