"""Opening image files: which formats are decoded, and how large they may be."""

import io
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import av
import numpy as np
from PIL import ExifTags, Image, JpegImagePlugin, UnidentifiedImageError

from anystyle.errors import UserError, one_line
from anystyle.io.documents import regular
from anystyle.io.limits import require

MAX_PIXELS = 400_000_000
"""The largest image that is accepted; only JPEG files of this size are decoded, reduced."""
MAX_DECODED = 100_000_000
"""The most pixels that are decoded: with the copies of a conversion about one gigabyte."""

Picture = Path | bytes
"""An image file, or the content of one."""


def check_pillow() -> None:
    """Refuse a process in which pycolmap was imported first: its zlib then serves Pillow, and ends the process."""
    order = [name for name in tuple(sys.modules) if name in ("pycolmap._core", "PIL._imaging")]
    if sys.platform == "linux" and order[0] == "pycolmap._core":
        told = "pycolmap was imported before Pillow, and would end the process at the first PNG file that is written"
        raise UserError(f"{told}; write `import PIL.Image` above `import pycolmap`")


@cache
def formats() -> tuple[str, ...]:
    """The formats that are decoded: of all that Pillow has, the decoder of EPS would start Ghostscript on a file."""
    check_pillow()
    Image.init()
    # Once and for all threads: `catch_warnings` around each file would leave the filters of one thread to the others.
    warnings.filterwarnings("ignore", module=r"PIL\.")
    with suppress(ImportError):
        from pillow_heif import register_heif_opener

        register_heif_opener()
    known = ("AVIF", "BMP", "GIF", "HEIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP")
    return tuple(name for name in known if name in Image.OPEN)  # AVIF is not in every build


@contextmanager
def opened(source: Picture, name: str = "") -> Iterator[Image.Image]:
    """Open an image and check its header; errors of decoders become a UserError that names the file."""
    what = name or str(source)
    if isinstance(source, Path):
        regular(source, most=None, what="image")
    decoded = formats()
    try:
        with _open(source, decoded) as image:
            if image.width * image.height > MAX_PIXELS:
                raise UserError(_too_large(image))
            yield image
    except UserError as error:
        raise UserError(f"{what}: {error}") from None
    except Image.DecompressionBombError:
        raise UserError(f"{what} has too many pixels; at most {MAX_DECODED:,} are decoded") from None
    except UnidentifiedImageError:
        suffix, hint = Path(what).suffix.lower(), ""
        if suffix in (".heic", ".heif") and "HEIF" not in decoded:
            hint = '; HEIC photographs need: pip install "anystyle[heic]"'
        elif suffix in (".tif", ".tiff"):
            hint = "; TIFF files of floating-point colours are not read, so save it with 8 or 16 bits"
        elif suffix in (".360", ".flv", ".insv", ".lrv", ".mxf", ".wmv"):
            hint = "; save films as .mp4, and those of 360° cameras cut into views"
        raise UserError(f"{what} is not an image that can be read, whatever its suffix{hint}") from None
    except Exception as error:  # decoders of damaged files raise nearly anything
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.filename is not None):
            raise
        raise UserError(f"{what} is a damaged image ({one_line(error)[:200] or type(error).__name__})") from None


def _open(source: Picture, decoded: tuple[str, ...]) -> Image.Image:
    """An image whose header is read; Pillow's limit does not hold for JPEG files, which can be decoded reduced."""
    try:
        return Image.open(source if isinstance(source, Path) else io.BytesIO(source), formats=decoded)
    except Image.DecompressionBombError:
        with suppress(SyntaxError):  # of another format
            return JpegImagePlugin.JpegImageFile(source if isinstance(source, Path) else io.BytesIO(source))
        raise


def stored_size(image: Image.Image) -> tuple[int, int]:
    """Width and height as the file stores its pixels; Pillow exchanges them where a TIFF file lies on its side."""
    tags = getattr(image, "tag_v2", {}) if image.format == "TIFF" else {}
    return tags.get(ExifTags.Base.ImageWidth, image.width), tags.get(ExifTags.Base.ImageLength, image.height)


def require_pixels(image: Image.Image, longest: int) -> None:
    """Refuse an image that takes too much memory; JPEG files are decoded at 1/2 to 1/8 size, not below ``longest``."""
    too_large = _too_large(image)
    image.draft("RGB", (longest, longest))
    pixels = image.width * image.height
    if pixels > MAX_DECODED:
        raise UserError(too_large)
    require(8 * pixels, f"{image.width} x {image.height} pixels", "make the image smaller")


def rounded_to_8_bits(image: Image.Image, source: Picture) -> Image.Image:
    """Colours of 16 bits rounded to 8, which Pillow would truncate, or mix up where planes are stored separately.

    Other images are returned as they are; ``source`` is what the image was opened from.
    """
    bits = _bits(image)
    if bits == 32 and image.mode == "I":
        raise UserError("levels of 32 bits are not read; save it with 8 or 16 bits")
    if bits != 16 or image.mode not in ("RGB", "RGBA"):
        return image
    require(40 * image.width * image.height, f"{image.width} x {image.height} pixels of 16 bits", "make it smaller")
    data = source if isinstance(source, bytes) else source.read_bytes()
    with av.open(io.BytesIO(data), "r", format="tiff_pipe" if image.format == "TIFF" else "png_pipe") as container:
        frame = next(container.decode(video=0))
    levels = frame.to_ndarray(format="rgba64le" if image.mode == "RGBA" else "rgb48le")
    rounded = Image.fromarray(((levels.astype(np.uint32) + 128) // 257).astype(np.uint8))
    rounded.info["icc_profile"] = image.info.get("icc_profile")
    rounded.getexif()[ExifTags.Base.Orientation] = image.getexif().get(ExifTags.Base.Orientation, 1)
    return rounded


def _bits(image: Image.Image) -> int:
    """Bits of a channel in the file: TIFF has a tag for it, and Pillow's decoder of PNG is called ``RGB;16B``."""
    if image.format == "TIFF":
        return max(getattr(image, "tag_v2", {}).get(ExifTags.Base.BitsPerSample, (8,)))
    return 16 if ";16" in str(getattr(image, "tile", "")) else 8


def _too_large(image: Image.Image) -> str:
    limit = f"at most {MAX_DECODED:,} are decoded, more only of JPEG files"
    return f"{image.width} x {image.height} pixels are too many; {limit}; make it smaller"
