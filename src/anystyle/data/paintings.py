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
    """Those files whose header is an image's; how many are not is said once in the log."""
    with ThreadPoolExecutor(8) as pool:
        good = [path for path, fine in zip(paths, pool.map(_opens, paths), strict=True) if fine]
    if len(good) < len(paths):
        first = next(path for path in paths if path not in set(good))
        logger.warning("%d of %d pictures cannot be read, such as %s", len(paths) - len(good), len(paths), first)
    return good


def _opens(path: Path) -> bool:
    try:
        image_size(path)
    except (ValueError, OSError):
        return False
    return True


def read_square(path: Path, size: int) -> Float[Tensor, "1 3 H W"]:
    """The middle square of a picture, its side scaled to ``size`` pixels.

    Raises:
        ValueError: It is no image or a damaged one.
    """
    width, height = image_size(path)
    image = open_image(path, longest=2 * size * max(width, height) // min(width, height) + 1)
    side = min(image.size)
    left, top = (image.width - side) / 2, (image.height - side) / 2
    square = image.resize((size, size), Image.Resampling.LANCZOS, box=(left, top, left + side, top + side))
    return to_tensor(square)[None]
