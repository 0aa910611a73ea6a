"""NumPy archives: the smallest file format."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.types import Gaussians, StyledScene


class ToyFormat(Format):
    """A NumPy archive with one array for each field of the Gaussians."""

    reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        _, gaussians = scene.styles[-1]
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **{name: tensor[0].numpy() for name, tensor in asdict(gaussians).items()})

    def read(self, path: Path) -> StyledScene:
        try:
            arrays = np.load(path)
            gaussians = Gaussians(**{name: torch.from_numpy(arrays[name])[None] for name in arrays})
        except Exception as error:  # parsers of damaged files raise nearly anything
            raise UserError(f"{path} is not an archive of Gaussians ({error})") from None
        return StyledScene(((path.stem, gaussians),), up=self.up)
