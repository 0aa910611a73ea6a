"""Opening image files: which formats are decoded, and how large they may be."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from anystyle.errors import UserError, one_line
from anystyle.io.limits import require

MAX_PIXELS = 178_000_000
"""The largest image that is accepted, as in Pillow; only JPEG files of this size are decoded, reduced."""
MAX_DECODED = 100_000_000
"""The most pixels that are decoded: with the copies of a conversion about one gigabyte."""

Picture = Path | bytes
"""An image file, or the content of one."""


@cache
def formats() -> tuple[str, ...]:
    """The formats that are decoded: of all that Pillow has, the decoder of EPS would start Ghostscript on a file."""
    Image.init()
    known = ("AVIF", "BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP")
    return tuple(name for name in known if name in Image.OPEN)  # AVIF is not in every build


@contextmanager
def opened(source: Picture, name: str = "") -> Iterator[Image.Image]:
    """Open an image and check its header; errors of decoders become a UserError that names the file."""
    what = name or str(source)
    if isinstance(source, Path) and not source.is_file():
        raise UserError(f"there is no image {source}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(source if isinstance(source, Path) else io.BytesIO(source), formats=formats()) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise UserError(_too_large(image))
                yield image
    except UserError as error:
        raise UserError(f"{what}: {error}") from None
    except Image.DecompressionBombError:
        raise UserError(f"{what} has too many pixels; at most {MAX_DECODED:,} are decoded") from None
    except UnidentifiedImageError:
        raise UserError(f"{what} is no image that can be read, whatever its name says") from None
    except Exception as error:  # decoders of damaged files raise nearly anything
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.filename is not None):
            raise
        raise UserError(f"{what} is a damaged image ({one_line(error)[:200] or type(error).__name__})") from None


def decodable(image: Image.Image, longest: int) -> None:
    """Refuse an image that takes too much memory; JPEG files are decoded at 1/2 to 1/8 size, not below ``longest``."""
    too_large = _too_large(image)
    image.draft("RGB", (longest, longest))
    pixels = image.width * image.height
    if pixels > MAX_DECODED:
        raise UserError(too_large)
    require(8 * pixels, f"{image.width} x {image.height} pixels", "make the image smaller")


def _too_large(image: Image.Image) -> str:
    limit = f"at most {MAX_DECODED:,} are decoded, more of JPEG files alone"
    return f"{image.width} x {image.height} pixels are too many; {limit}; make it smaller"
