"""Which image files are decoded."""

from functools import cache

from PIL import Image

_FORMATS = ("AVIF", "BMP", "GIF", "JPEG", "PNG", "PPM", "TIFF", "WEBP")


@cache
def formats() -> tuple[str, ...]:
    """The formats that image files may have, whatever their names say: pass them to ``Image.open``.

    Without them Pillow tries every decoder that it has; the one of EPS starts Ghostscript on the file.
    """
    Image.init()
    return tuple(name for name in _FORMATS if name in Image.OPEN)  # AVIF is not in every build
