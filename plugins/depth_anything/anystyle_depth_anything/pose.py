"""The network's pose encoding, which is of world-from-camera motions (layout: :mod:`anystyle.nn.pose`)."""

from jaxtyping import Float
from torch import Tensor

from anystyle.nn.pose import centred_cameras, encode, rotation_of
from anystyle.types import Cameras

LEAST_TANGENT = 1e-6
"""Of half a field of view, so that the focal length of a field of 0 is finite."""


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int]) -> Cameras:
    """Cameras, in OpenCV axes, of images with the principal point in the middle; fields of view are in radians."""
    tangent = (encoding[..., 7:] / 2).tan().clamp_min(LEAST_TANGENT)
    return centred_cameras(rotation_of(encoding), encoding[..., :3], tangent, size)


def encode_pose(cameras: Cameras) -> Float[Tensor, "B V 9"]:
    """The encoding of cameras, with the quaternion's real part at least 0."""
    return encode(cameras.world_from_camera, cameras)
