"""The one door for pictures: which image files are decoded, and how large they may be."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from anystyle.capacity import require
from anystyle.errors import UserError, one_line

MAX_PIXELS = 178_000_000
"""What an image may hold for its header to be believed, as Pillow has it; only JPEG files of this size are decoded."""
MAX_DECODED = 100_000_000
"""Pixels that are decoded at most: with all copies that a conversion needs, about one gigabyte."""
_DECODED = 8
"""Bytes that a pixel takes while it is decoded: of 16 bits, or four channels, and a copy of them in other ones."""

Picture = Path | bytes
"""An image file, or the content of one."""

_FORMATS = ("AVIF", "BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP")


@cache
def formats() -> tuple[str, ...]:
    """The formats that image files may have, whatever their names say: pass them to ``Image.open``.

    Without them Pillow tries every decoder that it has; the one of EPS starts Ghostscript on the file.
    """
    Image.init()
    return tuple(name for name in _FORMATS if name in Image.OPEN)  # AVIF is not in every build


@contextmanager
def opened(source: Picture, name: str = "") -> Iterator[Image.Image]:
    """An image whose header has been judged; all that decoders raise becomes one line that names the file.

    Args:
        source: A file, or the bytes of one.
        name: What messages call bytes.

    Raises:
        ValueError: It is no image, a damaged one, or too large.
        OSError: It cannot be read.
    """
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
    except Image.DecompressionBombError:
        raise UserError(f"{what} has too many pixels; at most {MAX_DECODED:,} are decoded") from None
    except UnidentifiedImageError:
        raise UserError(f"{what} is no image that can be read, whatever its name says") from None
    except MemoryError:
        raise
    except UserError as error:
        raise UserError(f"{what}: {error}") from None
    except Exception as error:
        # Decoders of damaged files raise nearly anything; what the system says of the file is passed on.
        if isinstance(error, OSError) and error.errno is not None and error.filename is not None:
            raise
        raise UserError(f"{what} is a damaged image ({one_line(error)[:200] or type(error).__name__})") from None


def decodable(image: Image.Image, longest: int) -> None:
    """Refuse an image that would take too much memory, or more than there is, before a pixel is decoded.

    JPEG files are told to be decoded at a half, a quarter or an eighth, to no less than ``longest``.

    Raises:
        ValueError: It holds more than :data:`MAX_DECODED` pixels then, or takes more memory than is free.
    """
    before = _too_large(image)
    image.draft("RGB", (longest, longest))
    if image.width * image.height > MAX_DECODED:
        raise UserError(before)
    pixels = image.width * image.height
    require(pixels * _DECODED, f"{image.width} x {image.height} pixels", "make the image smaller")


def _too_large(image: Image.Image) -> str:
    return (
        f"{image.width} x {image.height} pixels are too many; at most {MAX_DECODED:,} are decoded, more of JPEG files "
        "alone; make it smaller"
    )
