"""Cameras stored beside photographs: COLMAP, transforms.json of NeRF tools and DL3DV, poses_bounds.npy of LLFF."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.data.folder import SourceImage
from anystyle.io import colmap
from anystyle.types import Cameras

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StoredCamera:
    """One camera in OpenCV axes.

    Args:
        world_from_camera: 4x4.
        intrinsics: 3x3, in pixels of an image of ``size``.
        size: Height and width of the image they were stored for.
    """

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

    Args:
        folder: Of the scene.
        images: File names of its images, in order.
        stored_in: The file with the cameras, or the folder of COLMAP's model, below ``folder``; ``None`` looks for one.

    Raises:
        ValueError: A file is damaged or does not fit the images, or is not where it was said to be.
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
        raise ValueError(f"{path} is not there; cameras= names a file or a COLMAP model in the folder of every scene")
    return _llff(path, images) if path.suffix == ".npy" else _named(_transforms(path), images, path)


def _named(stored: Mapping[str, StoredCamera], images: Sequence[str], path: Path) -> dict[str, StoredCamera]:
    # Some tools leave the suffix out.
    pairs = [(name, stored.get(name, stored.get(PurePosixPath(name).stem))) for name in images]
    known = {name: camera for name, camera in pairs if camera is not None}
    if not known:
        raise ValueError(f"{path} names none of the photographs beside it")
    return known


def _colmap(folder: Path) -> dict[str, StoredCamera]:
    model = colmap.read(folder)
    models = {camera.model for camera in model.cameras.values()}
    fisheye = sorted(name for name in models if "FISHEYE" in name or name == "FOV")
    if fisheye:
        raise ValueError(f"{folder} has {fisheye[0]} cameras; undistort the images (colmap image_undistorter) first")
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


def _transforms(path: Path) -> dict[str, StoredCamera]:
    try:
        content = json.loads(path.read_text())
        return {
            PurePosixPath(str(frame["file_path"])).name: _frame({**content, **frame}) for frame in content["frames"]
        }
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ZeroDivisionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error).splitlines()[0]
        raise ValueError(f"{path} is not a transforms.json of cameras ({reason})") from None


def _frame(entry: Mapping[str, Any]) -> StoredCamera:
    width, height = int(entry["w"]), int(entry["h"])
    if width <= 0 or height <= 0:
        raise ValueError(f"an image of {width}x{height} pixels")
    fx = entry["fl_x"] if "fl_x" in entry else 0.5 * width / np.tan(0.5 * float(entry["camera_angle_x"]))
    fy = entry.get("fl_y", fx)
    cx, cy = entry.get("cx", width / 2), entry.get("cy", height / 2)
    intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    # OpenGL's camera looks along -z with y up.
    pose = _rigid(np.array(entry["transform_matrix"], dtype=np.float64)[:3] @ np.diag([1.0, -1.0, -1.0, 1.0]))
    return StoredCamera(pose, intrinsics, (height, width))


def _llff(path: Path, images: Sequence[str]) -> dict[str, StoredCamera]:
    try:
        rows = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path} is no array of poses ({str(error).splitlines()[0]})") from None
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise ValueError(f"{path} holds an array of shape {rows.shape}; N x 17 numbers are expected")
    if len(rows) != len(images):
        raise ValueError(f"{path} has {len(rows)} poses for {len(images)} images; remove images without a pose")
    cameras = {}
    for name, row in zip(images, rows.astype(np.float64), strict=True):
        matrix = row[:15].reshape(3, 5)
        height, width, focal = matrix[:, 4]
        if not (height >= 1 and width >= 1 and focal > 0):
            raise ValueError(f"{path} has a camera of {width:g}x{height:g} pixels and focal length {focal:g}")
        # Stored axes are down, right, back.
        axes = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        cameras[name] = StoredCamera(_rigid(axes), intrinsics, (round(height), round(width)))
    return cameras


def _rigid(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest rigid motion of a 3x4 matrix, of which stored ones are some rounding away."""
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
        raise ValueError("a pose is no finite 3x4 matrix")
    u, _, vt = np.linalg.svd(matrix[:, :3])
    rotation = u @ vt
    if np.linalg.det(rotation) < 0 or np.abs(rotation - matrix[:, :3]).max() > 0.02:
        raise ValueError("a pose has no rotation in it")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, matrix[:, 3]
    return pose
