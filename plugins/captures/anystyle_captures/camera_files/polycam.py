"""Polycam's raw data (developer mode): a file of each keyframe's camera."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.ranges import Positive
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import OPENCV_FROM_OPENGL, camera, finished, rigid
from anystyle_captures.camera_files.lens import MAX_SIDE, Lens
from anystyle_captures.camera_files.xml import starts_with

Side = Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)]
_IMAGES = {"corrected_cameras": ("corrected_images", "images"), "cameras": ("images",)}
"""Folders of photographs beside those of cameras, the first one that is there."""


_POSE = [f"t_{row}{column}" for row in range(3) for column in range(4)]


class _Lens(msgspec.Struct):
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    width: Side
    height: Side


_Keyframe = msgspec.defstruct("_Keyframe", [(name, float) for name in _POSE], bases=(_Lens,), kw_only=True)


class Polycam(CameraReader):
    """Keyframes of a LiDAR or room capture of Polycam, exported as raw data: ARKit's poses, or the corrected ones.

    Corrected cameras go with the corrected images. The world's unit is a metre, its y axis points up.
    """

    expects = "the keyframes of Polycam's raw data"
    rank = 60

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "keyframes" / "images")
        samples.write_polycam(folder / "keyframes" / "cameras", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        # The capture's folder, its keyframes, the photographs in these, or a folder of cameras.
        for base in (path / "keyframes", path, path.parent):
            for name, (images, *_) in _IMAGES.items():
                folder = base / name
                if base == path.parent and path.name not in (name, images):
                    continue
                first = min(folder.glob("*.json"), default=None) if folder.is_dir() else None
                if first is not None and starts_with(first, '"t_00"'):
                    return folder
        return None

    def photographs(self, path: Path) -> Path | None:
        folders = [path.parent / name for name in _IMAGES[path.name]]
        return next((folder for folder in folders if folder.is_dir()), None)

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        files = {file.stem: file for file in sorted(path.glob("*.json"))}
        cameras = {}
        for name in matched(files, images).values() if images else files:
            file = files[name]
            frame: _Lens = read_json(file, _Keyframe, what="camera of Polycam")
            pose = np.array([getattr(frame, name) for name in _POSE]).reshape(3, 4)
            try:
                lens = Lens((round(frame.height), round(frame.width)), (frame.fx, frame.fy), (frame.cx, frame.cy))
                cameras[name] = camera(rigid(pose @ OPENCV_FROM_OPENGL), lens)
            except UserError as error:
                raise UserError(f"{file} is not a camera of Polycam ({error})") from None
        return finished(cameras, images)
