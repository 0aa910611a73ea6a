"""Photographs as structure from motion takes them: pixels, a name, and what is known of the lens."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np
from jaxtyping import Float, UInt8
from PIL import ExifTags, Image
from torch import Tensor

FULL_FRAME_DIAGONAL = hypot(36, 24)
"""Of a film of 35 mm, in millimetres; what equivalent focal lengths refer to."""


@dataclass(frozen=True)
class Photograph:
    """A picture with what is known of its lens.

    Args:
        name: Names it in messages; distinct in a capture.
        pixels: Upright, sRGB.
        focal_length: In pixels, where something is known of it; it is refined.
        lens: Photographs of one lens and one size share their intrinsics. ``""`` where nothing is known.
    """

    name: str
    pixels: UInt8[np.ndarray, "H W 3"]
    focal_length: float | None = None
    lens: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.pixels.shape[0], self.pixels.shape[1]


@dataclass(frozen=True)
class Enlargement:
    """How a photograph was scaled before features were sought.

    Args:
        size: Height and width of the photograph.
        scaled: Height and width of what features were sought in.
    """

    size: tuple[int, int]
    scaled: tuple[int, int]

    @classmethod
    def between(cls, size: tuple[int, int], least: int, most: int) -> "Enlargement":
        """Small photographs are enlarged and large ones reduced until their longer side is in this range."""
        longer = max(size)
        factor = max(1.0, least / longer) if longer < most else most / longer
        return cls(size, (max(1, round(factor * size[0])), max(1, round(factor * size[1]))))

    @property
    def factors(self) -> tuple[float, float]:
        """Of enlargement, along x and y."""
        return self.scaled[1] / self.size[1], self.scaled[0] / self.size[0]

    def apply(self, photograph: Photograph) -> Image.Image:
        """The photograph's grey levels at the size for features."""
        picture = Image.fromarray(photograph.pixels).convert("L")
        height, width = self.scaled
        return picture if self.scaled == self.size else picture.resize((width, height), Image.Resampling.LANCZOS)


def photographs_from_tensor(images: Float[Tensor, "V 3 H W"], names: Sequence[str]) -> list[Photograph]:
    """Images in [0, 1] of one unknown lens; numbered where they have no names."""
    levels = (images.detach().cpu().clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).numpy()
    known = names or [str(number) for number in range(len(levels))]
    return [Photograph(name, pixels) for name, pixels in zip(known, levels, strict=True)]


def photograph_with_exif(name: str, pixels: UInt8[np.ndarray, "H W 3"], exif: Image.Exif) -> Photograph:
    """A photograph with the lens that its file tells of.

    Args:
        name: Of the photograph.
        pixels: Upright and whole; it may be reduced, not cropped.
        exif: As Pillow reads it: ``Image.open(path).getexif()``.
    """
    details = exif.get_ifd(ExifTags.IFD.Exif)
    written = [exif.get(ExifTags.Base.Make), exif.get(ExifTags.Base.Model)]
    written += [details.get(tag) for tag in (ExifTags.Base.LensModel, ExifTags.Base.FocalLength)]
    lens = " ".join(str(part).strip() for part in written if part is not None)
    return Photograph(name, pixels, _focal_length(details, pixels.shape[0], pixels.shape[1]), lens)


def _focal_length(details: dict[int, object], height: int, width: int) -> float | None:
    equivalent = _number(details.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent:
        return equivalent / FULL_FRAME_DIAGONAL * hypot(height, width)
    # Millimetres, and pixels per unit of the sensor at the size that it recorded.
    focal = _number(details.get(ExifTags.Base.FocalLength))
    density = _number(details.get(ExifTags.Base.FocalPlaneXResolution))
    unit = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}.get(int(_number(details.get(ExifTags.Base.FocalPlaneResolutionUnit))))
    recorded = [_number(details.get(tag)) for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)]
    if not (focal and density and unit and max(recorded)):
        return None
    return focal * density / unit * max(height, width) / max(recorded)


def _number(value: object) -> float:
    """A positive finite number of a file, else 0: cameras write nothing, zeros and fractions with a zero below."""
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0 < number < float("inf") else 0.0
