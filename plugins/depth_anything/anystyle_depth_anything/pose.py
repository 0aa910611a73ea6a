"""The network's pose encoding: translation (3), quaternion xyzw (4), vertical and horizontal field of view (2)."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.rotations import matrix_from_wxyz, wxyz_from_matrix, wxyz_from_xyzw, xyzw_from_wxyz
from anystyle.types import Cameras

LEAST_TANGENT = 1e-6
"""Of half a field of view, so that the focal length of a field of 0 is finite."""


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int]) -> Cameras:
    """Cameras of images of ``size`` with the principal point in the middle.

    Args:
        encoding: Of world-from-camera motions in OpenCV axes; fields of view in radians.
        size: Height and width in pixels.
    """
    height, width = size
    rotation = matrix_from_wxyz(wxyz_from_xyzw(encoding[..., 3:7]))
    last = encoding.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*encoding.shape[:-1], 1, 4)
    pose = torch.cat([torch.cat([rotation, encoding[..., :3, None]], dim=-1), last], dim=-2)
    tangent = (encoding[..., 7:] / 2).tan().clamp_min(LEAST_TANGENT)
    focal_y, focal_x = height / 2 / tangent[..., 0], width / 2 / tangent[..., 1]
    zero, one = torch.zeros_like(focal_x), torch.ones_like(focal_x)
    entries = [focal_x, zero, one * (width / 2), zero, focal_y, one * (height / 2), zero, zero, one]
    return Cameras(pose, torch.stack(entries, dim=-1).unflatten(-1, (3, 3)), size)


def encode_pose(cameras: Cameras) -> Float[Tensor, "B V 9"]:
    """The encoding of cameras, with the quaternion's real part at least 0."""
    height, width = cameras.size
    motion, intrinsics = cameras.world_from_camera, cameras.intrinsics
    quaternion = xyzw_from_wxyz(wxyz_from_matrix(motion[..., :3, :3]))
    vertical = 2 * torch.atan(height / 2 / intrinsics[..., 1, 1])
    horizontal = 2 * torch.atan(width / 2 / intrinsics[..., 0, 0])
    return torch.cat([motion[..., :3, 3], quaternion, torch.stack([vertical, horizontal], dim=-1)], dim=-1)
