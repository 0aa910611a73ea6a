"""What is read off the tokens: cameras, depth, and one raw Gaussian a pixel."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.tokens import normalised
from anystyle.types import Attributes, Cameras
from anystyle_backbones.heads import CameraRegressor, DptGaussians, centred_cameras, rotation_of


class CameraDecoder(CameraRegressor):
    """Reads pose encodings off camera tokens, in one pass."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.trunk = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, dim), nn.ReLU())
        self.translation = nn.Linear(dim, 3)
        self.quaternion = nn.Linear(dim, 4)
        self.field_of_view = nn.Linear(dim, 2)

    def forward(self, tokens: Float[Tensor, "B V C"]) -> Float[Tensor, "B V 9"]:
        """Pose encodings (layout: :func:`anystyle_backbones.heads.rotation_of`)."""
        x = self.trunk(tokens)
        return torch.cat([self.translation(x), self.quaternion(x), F.relu(self.field_of_view(x))], dim=-1)

    def cameras(self, tokens: Float[Tensor, "B V C"], size: tuple[int, int]) -> Cameras:
        return decode_pose(self(tokens).float(), size)


LEAST_TANGENT = 1e-6
"""Of half a field of view, so that the focal length of a field of 0 is finite."""


def decode_pose(encoding: Float[Tensor, "B V 9"], size: tuple[int, int]) -> Cameras:
    """Cameras, in OpenCV axes, of images with the principal point in the middle; fields of view are in radians."""
    tangent = (encoding[..., 7:] / 2).tan().clamp_min(LEAST_TANGENT)
    return centred_cameras(rotation_of(encoding), encoding[..., :3], tangent, size)


def direct_layers(width: int) -> nn.Sequential:
    """The layers that compute features of the image."""
    widths = (3, width // 4, width // 2, width)
    layers = [(nn.Conv2d(a, b, 3, padding=1), nn.GELU()) for a, b in pairwise(widths)]
    return nn.Sequential(*(module for pair in layers for module in pair))


class GaussianHead(DptGaussians, contracts.GaussianHead):
    """A decoder without a norm ahead of it, whose decoded map is joined by features of the image itself.

    The channels of the result: offset of the pixel (2), scale (3), quaternion (4), harmonics (3 K, colour-major),
    offset of the depth (1), opacity (1).
    """

    def image_features(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        return self.direct(normalised(images)).flatten(2).mT

    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        return Attributes(
            opacity=raw[..., -1],
            scale=raw[..., 2:5],
            rotation=raw[..., 5:9],
            color=raw[..., 9:-2].unflatten(-1, (3, self.coefficients)),
            offset=torch.cat([raw[..., :2], raw[..., -2:-1]], dim=-1),
        )
