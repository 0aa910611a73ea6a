"""Cameras stored beside photographs: COLMAP, transforms.json of NeRF tools and DL3DV, poses_bounds.npy of LLFF."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.data.folder import SourceImage
from anystyle.errors import UserError
from anystyle.io import colmap
from anystyle.io.arrays import read_array
from anystyle.io.documents import Positive, read_json
from anystyle.types import Cameras

_log = logging.getLogger(__name__)

MAX_SIDE = 1 << 20
"""Pixels that an image may be wide or high for a camera of it to be believed."""
_TRANSFORMS = "transforms.json of cameras"


@dataclass(frozen=True)
class StoredCamera:
    """One camera in OpenCV axes: a 4x4 pose and 3x3 intrinsics in pixels of an image of ``size``, height and width."""

    world_from_camera: NDArray[np.float64]
    intrinsics: NDArray[np.float64]
    size: tuple[int, int]

    def for_size(self, height: int, width: int) -> NDArray[np.float64]:
        """Intrinsics in pixels of the same image stored at another resolution."""
        scale = np.array([width / self.size[1], height / self.size[0], 1.0])
        return self.intrinsics * scale[:, None]


def view_camera(camera: StoredCamera, source: SourceImage) -> Cameras:
    """A stored camera as that of one view, for the part of its source that the view shows."""
    intrinsics = source.view_intrinsics(torch.from_numpy(camera.for_size(*source.size)))
    pose = torch.from_numpy(camera.world_from_camera)
    return Cameras(pose.float()[None, None], intrinsics.float()[None, None], source.view_size)


def read_poses(folder: Path, images: Sequence[str], stored_in: str | None = None) -> dict[str, StoredCamera]:
    """The cameras of a scene's images by file name; empty where none are stored.

    ``transforms.json`` and COLMAP's models name their images, which may lie in a folder of another resolution;
    ``poses_bounds.npy`` has one row an image in the order of their names. Lens distortion is not undone.
    ``stored_in`` is the file with the cameras, or the folder of COLMAP's model, below ``folder``; ``None`` looks for
    one.
    """
    if stored_in is None:
        files = (folder / name for name in ("transforms.json", "poses_bounds.npy"))
        path = next((file for file in files if file.is_file()), None) or colmap.find(folder)
        if path is None:
            return {}
    else:
        path = colmap.find(folder / stored_in) or folder / stored_in
    if path.is_dir() and colmap.find(path) is not None:
        return _named(_colmap(path), images, path)
    if not path.is_file():
        raise UserError(f"{path} is not there; cameras= names a file or a COLMAP model in the folder of every scene")
    return _llff(path, images) if path.suffix == ".npy" else _named(_transforms(path), images, path)


def stored_cameras(folder: Path) -> dict[str, StoredCamera]:
    """All cameras that ``transforms.json`` or a COLMAP model in a folder names, by file name; empty where none are."""
    path = folder / "transforms.json"
    if path.is_file():
        return _transforms(path)
    model = colmap.find(folder)
    return {} if model is None else _colmap(model)


def _named(stored: Mapping[str, StoredCamera], images: Sequence[str], path: Path) -> dict[str, StoredCamera]:
    # Some tools leave the suffix out.
    pairs = [(name, stored.get(name, stored.get(PurePosixPath(name).stem))) for name in images]
    known = {name: camera for name, camera in pairs if camera is not None}
    if not known:
        raise UserError(f"{path} names none of the photographs beside it")
    return known


def _colmap(folder: Path) -> dict[str, StoredCamera]:
    model = colmap.read(folder)
    models = {camera.model for camera in model.cameras.values()}
    fisheye = sorted(name for name in models if "FISHEYE" in name or name == "FOV")
    if fisheye:
        raise UserError(f"{folder} has {fisheye[0]} cameras; undistort the images (colmap image_undistorter) first")
    largest = max((abs(value) for camera in model.cameras.values() for value in camera.distortion), default=0.0)
    if largest > 1e-6:
        _log.warning("%s has distorted images (up to %.3g), which is not undone; undistort them first", folder, largest)
    cameras = {}
    for photograph in model.photographs.values():
        w, x, y, z = photograph.rotation
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix().T
        pose[:3, 3] = -pose[:3, :3] @ np.array(photograph.translation)
        camera = model.cameras[photograph.camera]
        cameras[PurePosixPath(photograph.name).name] = StoredCamera(pose, camera.intrinsics, camera.size)
    return cameras


class _Frame(msgspec.Struct):
    """The fields in ``transforms.json`` of a frame, or of all of them."""

    w: Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)] | None = None
    h: Annotated[float, msgspec.Meta(ge=1, le=MAX_SIDE)] | None = None
    fl_x: Positive | None = None
    fl_y: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    camera_angle_x: Annotated[float, msgspec.Meta(gt=0, lt=math.pi)] | None = None
    file_path: str = ""
    transform_matrix: list[list[float]] = []

    def camera(self, shared: "_Frame") -> StoredCamera:
        """The camera of a frame; values that it leaves out are the shared ones."""
        w, h, fx, fy, cx, cy, angle = (
            getattr(shared if getattr(self, name) is None else self, name)
            for name in ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x")
        )
        if w is None or h is None:
            raise UserError("there is no w and h, the size of the images")
        width, height = int(w), int(h)
        if fx is None and angle is None:
            raise UserError("there is no focal length: neither fl_x nor camera_angle_x")
        fx = 0.5 * width / math.tan(0.5 * angle) if fx is None else fx
        fy = fx if fy is None else fy
        cx, cy = width / 2 if cx is None else cx, height / 2 if cy is None else cy
        intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
        rows = self.transform_matrix
        if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
            raise UserError(f"transform_matrix of {self.file_path[:80]!r} is no 4x4 matrix")
        # OpenGL's camera looks along -z with y up.
        pose = _rigid(np.array(rows, np.float64)[:3] @ np.diag([1.0, -1.0, -1.0, 1.0]))
        return StoredCamera(pose, intrinsics, (height, width))


class _Transforms(_Frame, kw_only=True):
    frames: Annotated[list[_Frame], msgspec.Meta(max_length=100_000)]


def _transforms(path: Path) -> dict[str, StoredCamera]:
    content: _Transforms = read_json(path, _Transforms, what=_TRANSFORMS)
    try:
        return {PurePosixPath(frame.file_path).name: frame.camera(content) for frame in content.frames}
    except ValueError as error:
        raise UserError(f"{path} is no {_TRANSFORMS} ({error})") from None


def frame_names(path: Path) -> list[str]:
    """The names of the images that a ``transforms.json`` has cameras of."""
    content: _Transforms = read_json(path, _Transforms, what=_TRANSFORMS)
    return [PurePosixPath(frame.file_path).name for frame in content.frames]


def _llff(path: Path, images: Sequence[str]) -> dict[str, StoredCamera]:
    rows = read_array(path, what="array of poses, N x 17 numbers")
    if rows.ndim != 2 or rows.shape[1] != 17:
        raise UserError(f"{path} holds an array of shape {rows.shape}; N x 17 numbers are expected")
    if len(rows) != len(images):
        raise UserError(f"{path} has {len(rows)} poses for {len(images)} images; remove images without a pose")
    cameras = {}
    for name, row in zip(images, rows, strict=True):
        matrix = row[:15].reshape(3, 5)
        height, width, focal = matrix[:, 4]
        if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE and focal > 0):
            raise UserError(f"{path} has a camera of {width:g}x{height:g} pixels and focal length {focal:g}")
        # Stored axes are down, right, back.
        axes = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        try:
            cameras[name] = StoredCamera(_rigid(axes), intrinsics, (round(height), round(width)))
        except UserError as error:
            raise UserError(f"{path}: the pose of {name} is none ({error})") from None
    return cameras


def _rigid(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest rigid motion of a stored 3x4 matrix."""
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
        raise UserError("a pose is no finite 3x4 matrix")
    u, _, vt = np.linalg.svd(matrix[:, :3])
    rotation = u @ vt
    if np.linalg.det(rotation) < 0 or np.abs(rotation - matrix[:, :3]).max() > 0.02:
        raise UserError("a pose has no rotation in it")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, matrix[:, 3]
    return pose
