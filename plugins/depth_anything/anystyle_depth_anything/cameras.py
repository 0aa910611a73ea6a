"""From camera tokens to cameras, and from known cameras to camera tokens."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.attention import Block, Mlp
from anystyle.nn.pose import centred_cameras, encode, rotation_of
from anystyle.types import Cameras


class CameraDecoder(nn.Module):
    """Reads pose encodings off camera tokens, in one pass."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.trunk = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, dim), nn.ReLU())
        self.translation = nn.Linear(dim, 3)
        self.quaternion = nn.Linear(dim, 4)
        self.field_of_view = nn.Linear(dim, 2)

    def forward(self, tokens: Float[Tensor, "B V C"]) -> Float[Tensor, "B V 9"]:
        """Pose encodings (layout: :mod:`anystyle.nn.pose`)."""
        x = self.trunk(tokens)
        return torch.cat([self.translation(x), self.quaternion(x), F.relu(self.field_of_view(x))], dim=-1)


class CameraEncoder(nn.Module):
    """Camera tokens of known cameras, which take the place of the learnt ones."""

    def __init__(self, *, dim: int, depth: int, heads: int, mlp_ratio: float) -> None:
        super().__init__()
        self.pose_branch = Mlp(9, dim // 2, dim)
        self.token_norm = nn.LayerNorm(dim)
        self.trunk = nn.ModuleList(Block(dim, heads, mlp_ratio=mlp_ratio, layer_scale=0.01) for _ in range(depth))
        self.trunk_norm = nn.LayerNorm(dim)

    def forward(self, cameras: Cameras) -> Float[Tensor, "B V C"]:
        """One token a view."""
        x = self.token_norm(self.pose_branch(encode_pose(cameras).to(self.token_norm.weight.dtype)))
        for block in self.trunk:
            x = block(x)
        return self.trunk_norm(x)


LEAST_TANGENT = 1e-6
"""Of half a field of view, so that the focal length of a field of 0 is finite."""


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int]) -> Cameras:
    """Cameras, in OpenCV axes, of images with the principal point in the middle; fields of view are in radians."""
    tangent = (encoding[..., 7:] / 2).tan().clamp_min(LEAST_TANGENT)
    return centred_cameras(rotation_of(encoding), encoding[..., :3], tangent, size)


def encode_pose(cameras: Cameras) -> Float[Tensor, "B V 9"]:
    """The encoding of cameras, with the quaternion's real part at least 0."""
    return encode(cameras.world_from_camera, cameras)
