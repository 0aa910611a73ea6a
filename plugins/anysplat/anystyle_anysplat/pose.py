"""VGGT's pose encoding, which is of camera-from-world motions (layout: :mod:`anystyle.nn.pose`)."""

from jaxtyping import Float
from torch import Tensor

from anystyle.nn.pose import centred_cameras, encode, rotation_of
from anystyle.types import Cameras


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int], *, focal_epsilon: float) -> Cameras:
    """Cameras of images of ``size`` with the principal point in the middle.

    Args:
        encoding: In OpenCV axes; fields of view in radians.
        size: Height and width in pixels.
        focal_epsilon: Added to the tangent of half the field of view; AnySplat's weights were trained with 1e-3,
            VGGT's with 0.
    """
    rotation = rotation_of(encoding)
    origin = (-rotation.mT @ encoding[..., :3, None])[..., 0]
    return centred_cameras(rotation.mT, origin, (encoding[..., 7:] / 2).tan() + focal_epsilon, size)


def encode_pose(cameras: Cameras) -> Float[Tensor, "B V 9"]:
    """The encoding of cameras; the field of view is the true one, whatever epsilon a network decodes with."""
    return encode(cameras.camera_from_world, cameras)
