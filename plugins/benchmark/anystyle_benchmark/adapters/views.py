"""A job's photographs and paintings as arrays, and its results as files; needs only NumPy and Pillow."""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps


class Job:
    """The job whose file is the program's last argument; images are 8-bit RGB arrays ``[H, W, 3]``."""

    def __init__(self) -> None:
        asked = json.loads(Path(sys.argv[-1]).read_text())
        self.views, self.styles, self.seed = asked["views"], asked["styles"], asked["seed"]
        self.size, self.photographs, self.out = asked["size"], asked["photographs"], Path(asked["out"])

    def photograph(self, view: str) -> np.ndarray:
        """A view as it is judged: reduced, and cut to the size evenly."""
        return self.fitted(self.photographs[view])

    def fitted(self, path: str) -> np.ndarray:
        """A picture that covers a view."""
        return np.asarray(ImageOps.fit(opened(path), tuple(reversed(self.size)), Image.Resampling.LANCZOS))

    def painting(self, path: str) -> np.ndarray:
        """A picture at its own size."""
        return np.asarray(opened(path))

    def write(self, style: str, view: str, image: np.ndarray) -> None:
        """Write a result, 8-bit or in [0, 255]."""
        folder = self.out / style
        folder.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.clip(np.rint(image), 0, 255).astype(np.uint8)).save(folder / f"{view}.png")


def opened(path: str) -> Image.Image:
    """A picture the right way up, in RGB."""
    return ImageOps.exif_transpose(Image.open(path)).convert("RGB")
