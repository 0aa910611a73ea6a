"""VGGT's pose encoding: translation (3), quaternion xyzw (4), vertical and horizontal field of view (2)."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.rotations import matrix_from_wxyz, wxyz_from_matrix, wxyz_from_xyzw, xyzw_from_wxyz
from anystyle.types import Cameras


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int], *, focal_epsilon: float) -> Cameras:
    """Cameras of images of ``size`` with the principal point in the middle.

    Args:
        encoding: Of camera-from-world motions in OpenCV axes; fields of view in radians.
        size: Height and width in pixels.
        focal_epsilon: Added to the tangent of half the field of view; AnySplat's weights were trained with 1e-3,
            VGGT's with 0.
    """
    height, width = size
    rotation = matrix_from_wxyz(wxyz_from_xyzw(encoding[..., 3:7]))  # camera from world
    origin = -rotation.mT @ encoding[..., :3, None]
    last = encoding.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*encoding.shape[:-1], 1, 4)
    pose = torch.cat([torch.cat([rotation.mT, origin], dim=-1), last], dim=-2)
    tangent = (encoding[..., 7:] / 2).tan() + focal_epsilon
    focal_y, focal_x = height / 2 / tangent[..., 0], width / 2 / tangent[..., 1]
    zero, one = torch.zeros_like(focal_x), torch.ones_like(focal_x)
    entries = [focal_x, zero, one * (width / 2), zero, focal_y, one * (height / 2), zero, zero, one]
    return Cameras(pose, torch.stack(entries, dim=-1).unflatten(-1, (3, 3)), size)


def encode_pose(cameras: Cameras) -> Float[Tensor, "B V 9"]:
    """The encoding of cameras; the field of view is the true one, whatever epsilon a network decodes with."""
    height, width = cameras.size
    motion, intrinsics = cameras.camera_from_world, cameras.intrinsics
    quaternion = xyzw_from_wxyz(wxyz_from_matrix(motion[..., :3, :3]))
    vertical = 2 * torch.atan(height / 2 / intrinsics[..., 1, 1])
    horizontal = 2 * torch.atan(width / 2 / intrinsics[..., 0, 0])
    return torch.cat([motion[..., :3, 3], quaternion, torch.stack([vertical, horizontal], dim=-1)], dim=-1)
