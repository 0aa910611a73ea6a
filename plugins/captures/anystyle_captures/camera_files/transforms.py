"""``transforms.json`` of nerfstudio, other NeRF tools and DL3DV, and ``poses_bounds.npy`` of LLFF."""

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.images import image_size
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.arrays import read_array
from anystyle.io.documents import read_json
from anystyle.ranges import Positive
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import OPENCV_FROM_OPENGL, TOLERANCE, by_name, camera, finished, rigid
from anystyle_captures.camera_files.lens import MAX_SIDE, PANORAMAS, Lens

_log = logging.getLogger(__name__)
_SPLITS = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
_MODELS = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")


class _Frame(msgspec.Struct):
    """The fields in ``transforms.json`` of a frame, or of all of them."""

    w: Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)] | None = None
    h: Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)] | None = None
    fl_x: Positive | None = None
    fl_y: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    camera_angle_x: Annotated[float, msgspec.Meta(gt=0, lt=math.pi)] | None = None
    camera_angle_y: float | None = None
    k1: float | None = None
    k2: float | None = None
    k3: float | None = None
    k4: float | None = None
    p1: float | None = None
    p2: float | None = None
    camera_model: str | None = None
    is_fisheye: bool | None = None
    file_path: str = ""
    transform_matrix: list[list[float]] = []

    def camera(self, shared: "_Frame") -> StoredCamera:
        """The camera of a frame; values that it leaves out are the shared ones.

        A camera does not see how long its axes are: scaled ones, as Blender's can be, count as if of length 1.
        """
        own = {name: value for name, value in msgspec.structs.asdict(self).items() if value is not None}
        values = msgspec.structs.asdict(shared) | own
        if values["w"] is None or values["h"] is None:
            raise UserError("there is no w and h, the size of the images")
        width, height = int(values["w"]), int(values["h"])
        x, y = (own or other for own, other in zip(self.focal(width, height), shared.focal(width, height), strict=True))
        if (focal := x or y) is None:
            raise UserError("there is no focal length: neither fl_x nor camera_angle_x")
        model = values["camera_model"] or "OPENCV"
        if model == "EQUIRECTANGULAR":
            raise UserError(f"the images are panoramas (EQUIRECTANGULAR); {PANORAMAS}")
        if model not in _MODELS:
            raise UserError(f"camera_model {model[:40]} is not one of {', '.join(_MODELS)}; undistort the images first")
        k1, k2, k3, k4, p1, p2 = (values[name] or 0.0 for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
        fisheye = model == "OPENCV_FISHEYE" or values["is_fisheye"] is True
        cx, cy = values["cx"], values["cy"]
        center = width / 2 if cx is None else cx, height / 2 if cy is None else cy
        tangential = (0.0, 0.0) if fisheye else (p1, p2)
        lens = Lens((height, width), (x or focal, y or focal), center, (k1, k2, k3, k4), tangential, fisheye=fisheye)
        rows = self.transform_matrix
        if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
            raise UserError(f"transform_matrix of {self.file_path[:80]!r} is not a 4x4 matrix")
        return camera(rigid(np.array(rows, np.float64)[:3] @ OPENCV_FROM_OPENGL, length=self.length()), lens)

    def focal(self, width: int, height: int) -> list[float | None]:
        """In pixels, of both axes, from the length or else the angle of view."""
        given = (self.fl_x, self.camera_angle_x, width), (self.fl_y, self.camera_angle_y, height)
        known = ((length, angle if angle and 0 < angle < math.pi else None, side) for length, angle, side in given)
        return [length or (angle and 0.5 * side / math.tan(0.5 * angle)) for length, angle, side in known]

    def length(self) -> float:
        """The length of the axes of the camera; 1 if there is none."""
        return float(np.cbrt(abs(np.linalg.det(np.array(self.transform_matrix, np.float64)[:3, :3])))) or 1.0


class _Transforms(_Frame, kw_only=True):
    frames: Annotated[list[_Frame], msgspec.Meta(max_length=100_000)]


class Transforms(CameraReader):
    """``transforms.json`` of nerfstudio, instant-ngp and DL3DV: cameras of frames, shared or their own intrinsics.

    Blender's synthetic scenes have a file for each split, ``transforms_train.json`` and others, which are read as one.
    Where the files do not say how large the images are, their size is that of the first image.
    """

    expects = "transforms.json"
    rank = 10

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "images")
        samples.write_transforms(folder / "transforms.json", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        if path.is_dir():
            single = path / "transforms.json"
            return single if single.is_file() else path if _splits(path) else None
        return path if path.suffix == ".json" and path.is_file() else None

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        files = _splits(path) if path.is_dir() else [path]
        return finished(by_name([one for file in files for one in _cameras(file, images)], path), images)


def _splits(folder: Path) -> list[Path]:
    return [file for name in _SPLITS if (file := folder / name).is_file()]


def _cameras(path: Path, images: Sequence[Path]) -> list[tuple[str, StoredCamera]]:
    content: _Transforms = read_json(path, _Transforms, what="transforms.json of cameras")
    if content.w is None and content.h is None and any(frame.w is None for frame in content.frames):
        content.w, content.h = _size(path, content.frames, images)
    try:
        cameras = [(frame.file_path, frame.camera(content)) for frame in content.frames]
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    lengths = [frame.length() for frame in content.frames]
    if lengths and max(abs(length - 1) for length in lengths) > TOLERANCE:
        _log.warning("%s: the axes of cameras are up to %.3g long, and are taken as if of length 1", path, max(lengths))
    return cameras


def _size(path: Path, frames: Sequence[_Frame], images: Sequence[Path]) -> tuple[float | None, float | None]:
    """Width and height of the first image that is there: one of those given, or one below the file's folder."""
    names = [frame.file_path for frame in frames]
    below = [path.parent / f"{name}{suffix}" for name in names for suffix in ("", ".png")]
    first = next((image for image in (*matched(names, images), *below) if image.is_file()), None)
    return (None, None) if first is None else image_size(first)


class Llff(CameraReader):
    """``poses_bounds.npy`` of LLFF: one row of numbers per image, in the alphabetical order of their names."""

    expects = "poses_bounds.npy"
    rank = 20

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        samples.write_photographs(folder / "images")
        samples.write_llff(folder / "poses_bounds.npy", samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        file = path / "poses_bounds.npy" if path.is_dir() else path
        return file if file.suffix == ".npy" and file.is_file() else None

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        rows = read_array(path, what="array of poses, N x 17 numbers")
        if rows.ndim != 2 or rows.shape[1] != 17:
            raise UserError(f"{path} holds an array of shape {rows.shape}; N x 17 numbers are expected")
        if images and len(rows) != len(images):
            raise UserError(f"{path} has {len(rows)} poses for {len(images)} images; remove images without a pose")
        cameras = {}
        for image, row in zip(sorted(images), rows, strict=bool(images)):  # not in natural order: 10 before 2
            matrix = row[:15].reshape(3, 5)
            height, width, focal = matrix[:, 4]
            if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE and focal > 0):
                raise UserError(f"{path} has a camera of {width:g}x{height:g} pixels and focal length {focal:g}")
            # Stored axes are down, right, back.
            axes = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
            lens = Lens((round(height), round(width)), (focal, focal), (width / 2, height / 2))
            try:
                cameras[str(image)] = camera(rigid(axes), lens)
            except UserError as error:
                raise UserError(f"{path}: the pose of {image.name} is invalid ({error})") from None
        return cameras
