"""``cameras.json`` of the first trainer of 3D Gaussian splatting, and of those that began as copies of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.ranges import Positive
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import by_name, camera, finished, rigid
from anystyle_captures.camera_files.lens import MAX_SIDE, Lens

_Row = tuple[float, float, float]
_Side = Annotated[int, msgspec.Meta(ge=1, le=MAX_SIDE)]


class _Camera(msgspec.Struct):
    """A camera: position and rotation are those of the pose from camera to world, in OpenCV's axes."""

    img_name: str
    width: _Side
    height: _Side
    position: _Row
    rotation: tuple[_Row, _Row, _Row]
    fx: Positive
    fy: Positive


class GaussianSplatting(CameraReader):
    """Cameras of the first trainer's run, in the coordinates of its PLY files; the photographs have no distortion."""

    expects = "cameras.json of a run of 3DGS"
    rank = 5

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "images")
        samples.write_gaussian_splatting(folder / "cameras.json", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        file = path / "cameras.json" if path.is_dir() else path
        return file if file.suffix == ".json" and file.is_file() and file.read_bytes().lstrip()[:1] == b"[" else None

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        listed: list[_Camera] = read_json(path, list[_Camera], what="file of cameras of 3DGS")
        cameras = []
        for one in listed:
            lens = Lens((one.height, one.width), (one.fx, one.fy), (one.width / 2, one.height / 2))
            try:
                pose = rigid(np.column_stack([np.array(one.rotation), np.array(one.position)]))
            except UserError as error:
                raise UserError(f"{path}: {error} ({one.img_name[:80]})") from None
            cameras.append((one.img_name, camera(pose, lens)))
        return finished(by_name(cameras, path), images)
