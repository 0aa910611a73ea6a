"""Pose encodings: translation (3), quaternion xyzw (4), vertical and horizontal field of view (2).

Networks differ in the motion that they encode, from the camera to the world or back, and in how they keep focal
lengths finite.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_xyzw
from anystyle.types import Cameras


def rotation_of(encoding: Float[Tensor, "B V 9"]) -> Float[Tensor, "B V 3 3"]:
    """The encoded rotation."""
    return matrix_from_wxyz(wxyz_from_xyzw(encoding[..., 3:7]))


def centred_cameras(
    rotation: Float[Tensor, "B V 3 3"],
    origin: Float[Tensor, "B V 3"],
    tangent: Float[Tensor, "B V 2"],
    size: tuple[int, int],
) -> Cameras:
    """Cameras with the principal point in the middle of images of ``size``, height and width.

    ``rotation`` is world from camera; ``tangent`` that of half the vertical and half the horizontal field of view.
    """
    height, width = size
    last = origin.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*origin.shape[:-1], 1, 4)
    pose = torch.cat([torch.cat([rotation, origin[..., None]], dim=-1), last], dim=-2)
    focal_y, focal_x = height / 2 / tangent[..., 0], width / 2 / tangent[..., 1]
    zero, one = torch.zeros_like(focal_x), torch.ones_like(focal_x)
    entries = [focal_x, zero, one * (width / 2), zero, focal_y, one * (height / 2), zero, zero, one]
    return Cameras(pose, torch.stack(entries, dim=-1).unflatten(-1, (3, 3)), size)
