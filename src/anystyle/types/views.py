"""Inputs: photographs, cameras and styles."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from PIL import Image
from torch import Tensor

from anystyle.types.shapes import Given

SHOWN = 0.75
"""A smaller share of a photograph in its view is told of."""


@dataclass(frozen=True)
class Cameras(Given):
    """Pinhole cameras in OpenCV axes.

    Args:
        world_from_camera: Rigid motions.
        intrinsics: ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` in pixels of an image of ``size``.
        size: Height and width in pixels.
    """

    world_from_camera: Float[Tensor, "B V 4 4"]
    intrinsics: Float[Tensor, "B V 3 3"]
    size: tuple[int, int]

    @property
    def camera_from_world(self) -> Float[Tensor, "B V 4 4"]:
        """The inverse rigid motions, in closed form."""
        rotation, origin = self.world_from_camera[..., :3, :3], self.world_from_camera[..., :3, 3:]
        # Sums of products, for a matrix product would be rounded under autocast.
        back = -(rotation * origin).sum(-2)[..., None]
        return torch.cat([torch.cat([rotation.mT, back], dim=-1), self.world_from_camera[..., 3:, :]], dim=-2)

    def resized(self, size: tuple[int, int]) -> "Cameras":
        """The same cameras for images stretched to ``size``."""
        height, width = size
        scale = self.intrinsics.new_tensor([width / self.size[1], height / self.size[0], 1.0])
        return replace(self, intrinsics=self.intrinsics * scale[:, None], size=size)

    def select(self, views: "slice | list[int] | Int[Tensor, ' V']") -> "Cameras":
        """The cameras of some views."""
        return replace(self, world_from_camera=self.world_from_camera[:, views], intrinsics=self.intrinsics[:, views])


@dataclass(frozen=True)
class Views(Given):
    """Photographs of scenes, with what is known of them.

    Args:
        images: sRGB in [0, 1].
        cameras: Where they are known.
        depth: Distance along the camera's z axis, where it is known; 0 where a pixel has none.
        names: One per view, the same for every scene of the batch; may be empty.
        alpha: Alpha in [0, 1]; the images are composited over white. ``None`` is 1 everywhere.
        valid: Valid-pixel mask; pixels outside are ignored, such as those of passers-by. ``None`` is all pixels.
    """

    images: Float[Tensor, "B V 3 H W"]
    cameras: Cameras | None = None
    depth: Float[Tensor, "B V H W"] | None = None
    names: tuple[str, ...] = ()
    alpha: Float[Tensor, "B V H W"] | None = None
    valid: Bool[Tensor, "B V H W"] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.images.shape[-2], self.images.shape[-1]

    def select(self, views: list[int]) -> "Views":
        """Some of the views, in the order asked for."""
        names = tuple(self.names[view] for view in views) if self.names else ()
        return replace(self.map(lambda tensor: tensor[:, views]), names=names)


@dataclass(frozen=True)
class Style(Given):
    """Style references: an image, a text, or both, for each scene of a batch.

    Args:
        image: sRGB in [0, 1]; undefined where ``has_image`` is false.
        text: One description per scene; an empty one means there is none.
        has_image: Which rows of ``image`` hold one; ``None`` means all.
        names: One per style; may be empty.
    """

    image: Float[Tensor, "B 3 h w"] | None = None
    text: tuple[str, ...] | None = None
    has_image: Bool[Tensor, " B"] | None = None
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class TextMatch:
    """The nearest description to a text that a style encoder knows, and words of the text that it does not know.

    The similarity is by a measure of the encoder; 1 is the same. ``remedy`` is how unknown words are handled, or what
    would help.
    """

    text: str
    description: str
    similarity: float
    unknown_words: tuple[str, ...]
    remedy: str = ""


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

    @classmethod
    def covering(
        cls, name: str, source: tuple[int, int], size: tuple[int, int], *, whole: bool = False
    ) -> "SourceImage":
        """What a view of ``size`` shows of a source, both height and width: its middle, as large as fits.

        If that were less than :data:`SHOWN` of it, and it is to be ``whole``, all of it in the middle of the view.
        """
        scale, other = sorted((source[1] / size[1], source[0] / size[0]))
        if whole and scale < SHOWN * other:
            (height, width), (tall, wide) = size, (round(source[0] / other), round(source[1] / other))
            left, top, x, y = (width - wide) // 2, (height - tall) // 2, source[1] / wide, source[0] / tall
            return cls(name, source, (-left * x, -top * y, (width - left) * x, (height - top) * y), size)
        width, height = scale * size[1], scale * size[0]
        left, top = (source[1] - width) / 2, (source[0] - height) / 2
        return cls(name, source, (left, top, left + width, top + height), size)

    def of_view(self, picture: Image.Image) -> Image.Image:
        """What the view shows of an upright picture of the source, such as a mask, at any resolution."""
        return self.resampled(picture if self.straightened is None else self.straightened(picture))

    def resampled(self, straight: Image.Image, resample: Image.Resampling = Image.Resampling.BICUBIC) -> Image.Image:
        """What the view shows of an undistorted picture of the source; white beside it."""
        x, y = straight.width / self.size[1], straight.height / self.size[0]
        left, top, right, bottom = self.box
        # The view may be larger than the picture, and rounding may put the box a little outside of it.
        box = (max(left, 0) * x, max(top, 0) * y, min(right * x, straight.width), min(bottom * y, straight.height))
        inside = self.inside
        part = straight.resize((inside[2] - inside[0], inside[3] - inside[1]), resample, box=box)
        height, width = self.view_size
        if part.size == (width, height):
            return part
        whole = Image.new(part.mode, (width, height), "white")
        whole.paste(part, inside[:2])
        return whole

    @property
    def inside(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom, in pixels of the view, of the part that the source covers."""
        left, top, right, bottom = self.box
        (height, width), (view_height, view_width) = self.size, self.view_size
        x, y = view_width / (right - left), view_height / (bottom - top)
        first_column, first_row = max(0, round(-left * x)), max(0, round(-top * y))
        end_column, end_row = round((width - left) * x), round((height - top) * y)
        return first_column, first_row, min(view_width, end_column), min(view_height, end_row)

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
    The mask, of the picture's size, is black where it does not count, such as where it is transparent. ``panorama`` is
    how many views around the horizon it is cut into: none where it is 0, by its look and the default where it is not
    given.
    """

    name: str
    path: Path | None
    size: tuple[int, int]
    picture: Image.Image
    exif: Image.Exif
    mask: Image.Image | None = None
    panorama: int | None = None
