"""NumPy archives: the smallest file format."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_path
from anystyle.types import StyledScene


class ToyFormat(Format):
    """A NumPy archive with one array for each field of the Gaussians."""

    def write(self, scene: StyledScene, path: Path) -> None:
        _, gaussians = scene.styles[-1]
        arrays = {name: tensor[0].numpy() for name, tensor in asdict(gaussians).items()}  # N ... each
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)
