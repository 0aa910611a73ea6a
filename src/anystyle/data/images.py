"""Reading image files of any kind, without trusting them."""

import io
import logging
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import ExifTags, Image, ImageChops, ImageCms, ImageOps
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from anystyle.errors import UserError, listing, one_line
from anystyle.examples import resolved
from anystyle.io import color
from anystyle.io.images import Picture, formats, opened, require_pixels, rounded_to_8_bits, stored_size

logger = logging.getLogger(__name__)

SUFFIXES = frozenset(
    {".avif", ".bmp", ".gif", ".heic", ".heif", ".jfif", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp"}
)
"""File names that are taken for images in a folder."""

_CODES = re.compile(rb"(?:colrnclx.(.)\0|cICP(.))([\x10\x12])", re.DOTALL)
"""Primaries, and the transfer functions PQ (16) and HLG (18) of ITU-T H.273, as AVIF, HEIF and PNG files state them."""


def image_size(source: Picture, name: str = "") -> tuple[int, int]:
    """Width and height of the upright image, from its header only; messages call bytes by ``name``."""
    with opened(source, name) as image:
        width, height = stored_size(image)
        transposed = image.getexif().get(ExifTags.Base.Orientation) in (5, 6, 7, 8)
        return (height, width) if transposed else (width, height)


def photograph_size(path: Path, *, panoramas: bool = False) -> tuple[int, int]:
    """:func:`image_size` of a photograph; a panorama, which no perspective camera takes, is refused.

    Unless ``panoramas`` all around are wanted: equirectangular ones that are twice as wide as high.
    """
    kind, (width, height) = panorama_tag(path), image_size(path)
    if kind and not (panoramas and kind == "equirectangular" and width == 2 * height):
        told = f"{path} is a panorama ({kind}, {width}x{height}), which no perspective camera takes"
        raise UserError(f"{told}; whole equirectangular ones, twice as wide as high, are cut into views by poses=sfm")
    return width, height


def panorama_tag(path: Path) -> str:
    """The projection that 360° cameras and phones write, ``equirectangular`` or ``cylindrical``, or nothing.

    It is ``part of equirectangular`` where the image was cropped out of a whole one.
    """
    with opened(path) as image:
        xmp = image.info.get("xmp", b"")
    found = re.search(rb"GPano:ProjectionType\W{1,4}(equirectangular|cylindrical)", xmp)
    widths = {*re.findall(rb"GPano:(?:FullPano|CroppedAreaImage)WidthPixels\W{1,4}(\d+)", xmp)}
    return f"{'part of ' * (len(widths) > 1)}{found[1].decode()}" if found else ""


def hdr_codes(source: Picture) -> tuple[int, int] | None:
    """Primaries and transfer function of a photograph of high dynamic range (PQ or HLG), numbers of ITU-T H.273.

    Nothing where that is a second picture, by a gain map (``tmap`` of ISO 21496-1).
    """
    with io.BytesIO(source) if isinstance(source, bytes) else source.open("rb") as file:
        start = file.read(1 << 16)
    found = None if b"tmap" in start else _CODES.search(start)
    return (ord(found[1] or found[2]), ord(found[3])) if found else None


def read_exif(path: Path) -> Image.Exif:
    """What a camera wrote into an image file; empty where it wrote nothing."""
    with opened(path) as image:
        return image.getexif()


def open_image(source: Picture, name: str = "", *, longest: int = 4096, masked: bool = False) -> Image.Image:
    """Read an image as upright 8-bit sRGB: grey, 16-bit, CMYK, palette and transparent ones too.

    What is transparent shows white; colours of another profile that the file holds are converted, and those of high
    dynamic range. The size is checked before any pixel is decoded, and a larger image is reduced while it is read, so
    that memory stays bounded.

    Args:
        source: A file that Pillow opens, or the bytes of one.
        name: What to call bytes in messages.
        longest: Images with a longer side are reduced to no less than this.
        masked: Transparency is a mask, and not white: the image is cropped to what is opaque, which is mirrored at its
            edges into what is left of the transparent pixels. So a painting that is cut out is looked at.
    """
    with opened(source, name) as image:
        upright, codes = _upright(image, source, longest), hdr_codes(source)
        upright = upright if codes else _to_srgb(upright)
        colors = _to_rgb(_opaque(upright) if masked else upright)
        return color.to_sdr(colors, *codes) if codes else colors


def open_alpha(source: Picture, name: str = "", *, longest: int = 4096) -> Image.Image | None:
    """The alpha channel of an image, as :func:`open_image` would reduce it; ``None`` where it is opaque everywhere."""
    with opened(source, name) as image:
        if not _has_alpha(image):
            return None
        alpha = _upright(image, source, longest).convert("RGBA").getchannel("A")
        return None if alpha.getextrema() == (255, 255) else alpha


def _upright(image: Image.Image, source: Picture, longest: int) -> Image.Image:
    require_pixels(image, longest)
    factor = max(1, max(image.size) // longest)
    whole = rounded_to_8_bits(image, source)
    return ImageOps.exif_transpose(whole if factor == 1 else _averaging(whole).reduce(factor))


def _has_alpha(image: Image.Image) -> bool:
    return image.mode in ("RGBA", "LA", "PA") or ("transparency" in image.info and image.mode in ("1", "L", "RGB", "P"))


def read_image(image: str | Path | Image.Image, *, longest: int = 1024, masked: bool = False) -> Float[Tensor, "3 H W"]:
    """Read an image as sRGB in [0, 1], reduced so that its longer side is at most ``longest`` pixels.

    It is a file, ``example:NAME`` or one that Pillow has opened; :func:`open_image` says how each kind is read.

    Example:
        >>> images = torch.stack([anystyle.read_image(path) for path in paths])
        >>> scene = stylizer.encode(anystyle.types.Views(images[None]))
    """
    if isinstance(image, Image.Image):
        upright = _to_srgb(ImageOps.exif_transpose(image))
        image = _to_rgb(_opaque(upright) if masked else upright)
    else:
        image = open_image(resolved(Path(image)), longest=longest, masked=masked)
    image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    return to_tensor(image)


def to_tensor(image: Image.Image) -> Float[Tensor, "3 H W"]:
    """An 8-bit RGB image as a tensor in [0, 1]."""
    return torch.from_numpy(np.array(image)).permute(2, 0, 1).float().div_(255)


def _averaging(image: Image.Image) -> Image.Image:
    """An image whose values have a mean: indices of a palette have none, and Pillow has none of 16-bit levels."""
    if image.mode in ("LA", "RGBA") or (image.mode in ("L", "RGB", "CMYK", "I", "F") and not _has_alpha(image)):
        return image
    return image.convert("I" if image.mode.startswith("I") else "RGBA" if _has_alpha(image) else "RGB")


def _to_srgb(image: Image.Image) -> Image.Image:
    """An image converted from its embedded ICC profile to sRGB.

    Where only one of image and profile is greyscale, the profile does not apply, and the image is returned unchanged.
    """
    profile = image.info.get("icc_profile") or b""
    mode = "L" if image.mode.startswith("I") else _WITHOUT_ALPHA.get(image.mode)
    if not profile or mode is None or (mode == "L") != (profile[16:20] == b"GRAY"):
        return image
    try:
        transform = _transform(profile, mode)
    except (ImageCms.PyCMSError, OSError) as error:
        logger.warning("a colour profile cannot be read, and its colours are taken for sRGB (%s)", one_line(error))
        return image
    if transform is None:
        return image
    colors = (_to_rgb(image) if image.mode.startswith("I") else image).convert(mode)
    converted = ImageCms.applyTransform(colors, transform) or colors
    if _has_alpha(image):
        converted.putalpha(image.convert("RGBA").getchannel("A"))
    return converted


_WITHOUT_ALPHA = {"L": "L", "LA": "L", "P": "RGB", "PA": "RGB", "RGB": "RGB", "RGBA": "RGB", "CMYK": "CMYK"}
"""The modes of images that are converted, and the mode without alpha in which ICC profiles apply to them."""


@lru_cache(maxsize=64)
def _transform(profile: bytes, mode: str) -> ImageCms.ImageCmsTransform | None:
    """The transform from a profile to sRGB; ``None`` if it changes no level by more than 1, as sRGB's own profiles."""
    source, srgb = ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
    transform = ImageCms.buildTransform(source, srgb, mode, "RGB")
    if mode == "RGB":
        colors = Image.merge("RGB", [Image.linear_gradient("L").rotate(turn) for turn in (0, 90, 180)])
        change = ImageChops.difference(colors, ImageCms.applyTransform(colors, transform) or colors)
        if np.asarray(change).max() <= 1:
            return None
    return transform


def _to_rgb(image: Image.Image) -> Image.Image:
    if image.mode.startswith("I") or image.mode == "F":
        # 16-bit files hold up to 65535, whatever the mode's own range; floating-point ones up to 1.
        values = np.asarray(image).astype(np.float32) * np.float32(255 / (65535 if image.mode.startswith("I") else 1))
        return Image.fromarray(np.nan_to_num(values).round().clip(0, 255).astype(np.uint8)).convert("RGB")
    if _has_alpha(image):
        image = image.convert("RGBA")
        return Image.alpha_composite(Image.new("RGBA", image.size, "white"), image).convert("RGB")
    return image.convert("RGB")


def _opaque(image: Image.Image) -> Image.Image:
    """What is at least half opaque of an image, and its mirror image in the rest of its bounding box."""
    if not _has_alpha(image):
        return image
    pixels = np.asarray(image.convert("RGBA"))
    rows, columns = np.nonzero(pixels[..., 3] >= 128)
    if not len(rows):
        raise UserError("a picture is transparent everywhere; give one with something in it")
    pixels = pixels[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    opaque = pixels[..., 3] >= 128
    nearest = distance_transform_edt(~opaque, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    mirrored = np.clip(2 * nearest - np.indices(opaque.shape), 0, np.array(opaque.shape)[:, None, None] - 1)
    rows, columns = np.where(opaque[tuple(mirrored)], mirrored, nearest)
    return Image.fromarray(pixels[rows, columns, :3])


def readable(paths: Sequence[Path]) -> list[Path]:
    """The files whose header is an image's; others are logged, each with its reason.

    Raises:
        OSError: A file cannot be read at all, which is not the fault of its content.
    """
    formats()  # before threads: decoders register themselves at the first picture
    with ThreadPoolExecutor(8) as pool:
        reasons = list(pool.map(_why_unreadable, paths))
    if bad := [reason for reason in reasons if reason is not None]:
        logger.warning("%d of %d pictures cannot be read and are left out: %s", len(bad), len(paths), listing(bad))
    return [path for path, reason in zip(paths, reasons, strict=True) if reason is None]


def _why_unreadable(path: Path) -> str | None:
    try:
        image_size(path)
    except UserError as error:
        return str(error)
    return None


def read_square(source: Picture, size: int, position: float = 0.5, name: str = "") -> Float[Tensor, "1 3 H W"]:
    """A square of a picture, scaled to ``size`` pixels, from ``position`` along the longer side: 0.5 is its middle.

    Messages call bytes by ``name``.
    """
    name = "" if isinstance(source, Path) else name
    width, height = image_size(source, name)
    image = open_image(source, name, longest=2 * size * max(width, height) // min(width, height) + 1)
    side = min(image.size)
    left, top = (image.width - side) * position, (image.height - side) * position
    square = image.resize((size, size), Image.Resampling.LANCZOS, box=(left, top, left + side, top + side))
    return to_tensor(square)[None]
