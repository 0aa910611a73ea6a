"""From photographs, and cameras where they are known, to tokens."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.geometry.transforms import wxyz_from_matrix
from anystyle.types import Cameras, Tokens
from anystyle_backbones.anysplat import transformer

MARGIN = 0.1
"""Of the unit cube, on each side of the positions that are placed in it."""
FEW = 10
"""Up to so many views the extremes of their positions span the cube, with more the quantiles of 5 and 95 percent."""


class Embedder(transformer.Embedder, contracts.Embedder):
    """AnySplat's embedder with two more tokens a view behind the registers: its pose and its lens.

    A token of what is not known, or not to be read, is zero. Options are explained at
    :class:`~anystyle_backbones.worldmirror.WorldMirror`.
    """

    reads_cameras = True

    def __init__(
        self,
        dim: int,
        patches: transformer.DinoV2,
        *,
        registers: int,
        patch_size: int,
        known: Literal["nothing", "lenses", "cameras"],
    ) -> None:
        super().__init__(dim, patches, registers=registers, patch_size=patch_size, reference="first", blank=2)
        self.pose = _embedding(7, dim) if known == "cameras" else None
        self.lens = _embedding(4, dim) if known != "nothing" else None

    def forward(self, images: Float[Tensor, "B V 3 H W"], cameras: Cameras | None = None) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        tokens = super().forward(images)
        if cameras is None or self.lens is None:
            return tokens
        pose, lens = tokens.data[:, :, tokens.special - 2 : tokens.special].unbind(2)
        if self.pose is not None:
            pose = self.pose(pose_encoding(cameras.world_from_camera).to(pose.dtype))
        lens = self.lens(lens_encoding(cameras).to(lens.dtype))
        leading = tokens.data[:, :, : tokens.special - 2]
        return tokens.with_data(torch.cat([leading, torch.stack([pose, lens], dim=2), tokens.patches], dim=2))


def _embedding(numbers: int, dim: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(numbers, dim), nn.SiLU(), nn.Linear(dim, dim))


def pose_encoding(poses: Float[Tensor, "B V 4 4"]) -> Float[Tensor, "B V 7"]:
    """Positions in the unit cube, by their range in the scene, and unit quaternions xyzw with ``w`` at least 0."""
    places = poses[..., :3, 3]
    ends = places.new_tensor([0.0, 1.0] if places.shape[1] <= FEW else [0.05, 0.95])
    low, high = torch.quantile(places, ends, dim=1, keepdim=True)
    span = (high - low).maximum(1e-6 * high.abs()).amax(dim=-1, keepdim=True).clamp(1e-6, 1e6)
    inside = (places - (low + high) / 2) * (1 - 2 * MARGIN) / span + 0.5
    return torch.cat([inside.clamp(0, 1), wxyz_from_matrix(poses[..., :3, :3]).roll(-1, dims=-1)], dim=-1)


def lens_encoding(cameras: Cameras) -> Float[Tensor, "B V 4"]:
    """Focal lengths and principal point, horizontal and vertical in turn, in sides of the image."""
    focal = cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
    size = focal.new_tensor([cameras.size[1], cameras.size[0]])
    return torch.cat([focal / size, cameras.intrinsics[..., :2, 2] / size], dim=-1)
