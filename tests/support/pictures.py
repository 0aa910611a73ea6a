"""Pictures in files, in folders that may be new."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image


def save(path: Path, pixels: np.ndarray, **options: Any) -> Path:
    """Write 8-bit pixels; ``options`` are those of the format."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, **options)
    return path


def picture(path: Path, value: int, size: tuple[int, int] = (12, 8)) -> Path:
    """A grey picture of one value; its size is width and height."""
    return save(path, np.full((size[1], size[0], 3), value, dtype=np.uint8))


def save_photographs(folder: Path, names: Sequence[str], height: int, width: int, **options: Any) -> Path:
    """A folder of noise that moves aside from picture to picture."""
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    for number, name in enumerate(names):
        save(folder / name, np.roll(pixels, 3 * number, 1), **options)
    return folder
