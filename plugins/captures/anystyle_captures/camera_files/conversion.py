"""Poses and photographs as programs store them, as the core's cameras."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from PIL import ExifTags, Image

from anystyle.contracts import StoredCamera, Undistortion
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.images import opened, stored_size
from anystyle_captures.camera_files.lens import Lens

_log = logging.getLogger(__name__)
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL's camera looks along -z with y up."""
TOLERANCE = 0.02
"""By how much the numbers of a rotation may be off."""
FAR = 1e4
"""Cameras further from the origin than so many times their spread are moved there, for 32-bit numbers to hold them."""


def rigid(matrix: np.ndarray, *, length: float = 1.0) -> Float64[np.ndarray, "4 4"]:
    """The nearest rigid motion of a stored 3x4 or 4x4 matrix whose axes are ``length`` long."""
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise UserError("a pose is not a finite 3x4 matrix")
    axes = matrix[:3, :3] / length
    u, _, vt = np.linalg.svd(axes)
    rotation = u @ vt
    if np.abs(rotation - axes).max() > TOLERANCE:
        raise UserError("a pose has no rotation in it")
    if np.linalg.det(rotation) < 0:
        raise UserError("a pose mirrors: its axes are left-handed, as Unity's are; turn one of them round")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, matrix[:3, 3]
    return pose


def camera(world_from_camera: np.ndarray, lens: Lens) -> StoredCamera:
    """A camera with the undistortion that its lens needs."""
    return StoredCamera(world_from_camera, lens.matrix(), lens.size, lens.undistortion())


def by_name(cameras: Iterable[tuple[str, StoredCamera]], path: Path) -> dict[str, StoredCamera]:
    """Cameras by the names that a file has for them, once each."""
    found: dict[str, StoredCamera] = {}
    for name, one in cameras:
        if name in found:
            raise UserError(f"{path} has two cameras of the name {name}; give photographs names of their own")
        found[name] = one
    return found


def finished(cameras: Mapping[str, StoredCamera], images: Sequence[Path]) -> dict[str, StoredCamera]:
    """Cameras near the origin, and for upright photographs where theirs are stored lying on a side."""
    found = dict(cameras)
    for image, name in matched(found, images).items():
        found[name] = _upright(found[name], image)
    positions = np.array([one.world_from_camera[:3, 3] for one in found.values()]).reshape(-1, 3)
    if not len(positions):
        return found
    center = np.median(positions, axis=0)
    spread = max(float(np.abs(positions - center).max()), 1e-12)
    if float(np.abs(center).max()) <= FAR * spread or len(positions) == 1:
        return found
    _log.info("the cameras lie far from the origin; %s is taken for it", np.array2string(center, precision=3))
    moved = np.zeros((4, 4))
    moved[:3, 3] = center
    return {name: replace(one, world_from_camera=one.world_from_camera - moved) for name, one in found.items()}


def _upright(stored: StoredCamera, path: Path) -> StoredCamera:
    """The camera of the upright photograph, if that is stored lying on a side and the camera is of it as it lies."""
    try:
        with opened(path) as image:
            orientation, (across, down) = image.getexif().get(ExifTags.Base.Orientation), stored_size(image)
    except UserError:  # reading the photograph reports it
        return stored
    height, width = stored.size
    if orientation not in (6, 8) or (across > down) != (width > height):
        return stored
    # Pixels of the upright photograph from those of the stored one, for a quarter turn clockwise or back.
    turn = np.array([[0.0, -1.0, height], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    upright, lay = Image.Transpose.ROTATE_270, Image.Transpose.ROTATE_90
    if orientation == 8:
        turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, width], [0.0, 0.0, 1.0]])
        upright, lay = lay, upright
    rotation = turn * [[1, 1, 0], [1, 1, 0], [1, 1, 1]]
    pose = stored.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ rotation.T
    straight = stored.undistortion
    if straight is not None:
        straight = Undistortion(
            lambda picture, apply=straight.apply: apply(picture.transpose(lay)).transpose(upright),
            turn @ straight.intrinsics @ rotation.T,
        )
    return StoredCamera(pose, turn @ stored.intrinsics @ rotation.T, (width, height), straight)
