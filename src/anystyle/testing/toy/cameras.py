"""A table of positions: the smallest reader of cameras."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.errors import UserError


class ToyCameras(CameraReader):
    """Lines of a name and three numbers, of cameras that all look ahead and see 90 degrees of a square."""

    expects = "toy_cameras.txt"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        Image.new("RGB", (8, 8)).save(folder / "a.png")
        (folder / "toy_cameras.txt").write_text("a.png 0 1 2\n")
        return {}

    def find(self, path: Path) -> Path | None:
        file = path / "toy_cameras.txt" if path.is_dir() else path
        return file if file.name == "toy_cameras.txt" and file.is_file() else None

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        cameras = {}
        for line in path.read_text(encoding="utf-8").splitlines():
            name, *numbers = line.split()
            if len(numbers) != 3 or not all(number.removeprefix("-").isdecimal() for number in numbers):
                raise UserError(f"{path}: {line[:80]!r} is not a name and a position")
            pose = np.eye(4)
            pose[:3, 3] = [float(number) for number in numbers]
            cameras[name] = StoredCamera(pose, np.array([[4.0, 0, 4], [0, 4.0, 4], [0, 0, 1]]), (8, 8))
        return cameras
