"""Pictures of one size from files of any size: what folders of paintings share."""

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.data.images import image_size, open_image, to_tensor

logger = logging.getLogger(__name__)


def readable(paths: Sequence[Path]) -> list[Path]:
    """Those files whose header is an image's; the log says how many are not, and which."""
    with ThreadPoolExecutor(8) as pool:
        fine = list(pool.map(_opens, paths))
    bad = [path for path, opens in zip(paths, fine, strict=True) if not opens]
    if bad:
        logger.warning("%d of %d pictures cannot be read and are left out: %s", len(bad), len(paths), listing(bad))
    return [path for path, opens in zip(paths, fine, strict=True) if opens]


def listing(items: Sequence[object], most: int = 10) -> str:
    """Items in one line, the first ones where there are many."""
    shown = ", ".join(str(item) for item in items[:most])
    return shown + (f" and {len(items) - most} more" if len(items) > most else "")


def _opens(path: Path) -> bool:
    try:
        image_size(path)
    except (ValueError, OSError):
        return False
    return True


def read_square(path: Path, size: int, position: float = 0.5) -> Float[Tensor, "1 3 H W"]:
    """A square of a picture, scaled to ``size`` pixels, from ``position`` along the longer side: 0.5 is its middle.

    Raises:
        ValueError: It is no image or a damaged one.
    """
    width, height = image_size(path)
    image = open_image(path, longest=2 * size * max(width, height) // min(width, height) + 1)
    side = min(image.size)
    left, top = (image.width - side) * position, (image.height - side) * position
    square = image.resize((size, size), Image.Resampling.LANCZOS, box=(left, top, left + side, top + side))
    return to_tensor(square)[None]
