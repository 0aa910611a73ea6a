"""What is read off the tokens: rays and depths of pixels, poses of views, and the scale of the scene."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_xyzw
from anystyle.types import Features, Geometry
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import decoded_maps, pinhole_cameras
from anystyle_backbones.pointmaps import lens_of, renderable

SCALE_HIDDEN = 196
"""Channels of the hidden layers that predict the scale."""


class PoseHead(nn.Module):
    """A view's pose from its patch tokens: residual layers on each, then their average.

    Source: ``PoseHead`` of UniCeption (``uniception/models/prediction_heads/pose_head.py``).
    """

    def __init__(self, dim: int, hidden: int) -> None:
        super().__init__()

        def layers(count: int) -> nn.Sequential:
            return nn.Sequential(*(m for _ in range(count) for m in (nn.Linear(hidden, hidden), nn.ReLU())))

        self.proj = nn.Linear(dim, hidden)
        self.residuals = nn.ModuleList(layers(3) for _ in range(2))
        self.mlp = layers(2)
        self.translation = nn.Linear(hidden, 3)
        self.quaternion = nn.Linear(hidden, 4)

    def forward(self, patches: Float[Tensor, "B V P C"]) -> Float[Tensor, "B V 7"]:
        """World from camera: translation ahead of the scene's scale (3), quaternion xyzw of any norm (4)."""
        x = self.proj(patches)
        for residual in self.residuals:
            x = x + residual(x)
        x = self.mlp(x.mean(2))
        return torch.cat([self.translation(x), self.quaternion(x)], dim=-1)


def scale_head(dim: int) -> nn.Sequential:
    """The logarithm of the scene's scale, from its token.

    Source: ``MLPHead`` of UniCeption (``uniception/models/prediction_heads/mlp_head.py``).
    """
    hidden = SCALE_HIDDEN
    layers = (nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
    return nn.Sequential(nn.Linear(dim, hidden), *layers, nn.Linear(hidden, 1))


class GeometryHead(contracts.GeometryHead):
    """World points in metres from rays, distances, poses and a scale, and pinhole cameras that see them.

    Depth is the points' z in their view's camera. Intrinsics are fitted to the rays, so that points need not lie on the
    rays of the cameras. A pixel of published intrinsics is at its index; here it is half a pixel further, where pixels
    are seen.

    Args:
        dense: Predicts for each pixel a ray (3), the logarithm of the distance along it (1), the logarithm of
            confidence less one (1), and the logit of the distance being known, unlike a sky's (1), which is not read.
        pose: Predicts poses.
        scale: Predicts the logarithm of the scale.
        taps: The layers that ``dense`` reads, four, in rising order.
        chunk: Views decoded at a time, which changes memory only.

    Source: ``MapAnything.forward`` (``mapanything/models/mapanything/model.py``) and
    ``postprocess_model_outputs_for_inference`` (``mapanything/utils/inference.py``) without its masks.
    """

    def __init__(self, dense: Dpt, pose: PoseHead, scale: nn.Sequential, *, taps: Sequence[int], chunk: int) -> None:
        super().__init__()
        self.dense, self.pose, self.scale = dense, pose, scale
        self.taps, self.chunk = tuple(taps), chunk

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry; the confidence is at least 1."""
        size, last = (images.shape[-2], images.shape[-1]), features[self.taps[-1]]
        with torch.autocast(images.device.type, enabled=False):  # positions need all their bits
            raw = decoded_maps(self.dense, [features[layer] for layer in self.taps], size, chunk=self.chunk).float()
            pose = self.pose(last.patches.to(self.dense.dtype)).float()
            scale = self.metric(last.data[:, 0, 0].to(self.dense.dtype))[:, None]  # B 1 1
            rays = F.normalize(raw[..., :3], dim=-1, eps=1e-8)
            rotation = matrix_from_wxyz(wxyz_from_xyzw(pose[..., 3:]))
            origin = pose[..., :3] * scale
            local = rays * (raw[..., 3:4].exp() * scale[..., None, None])
            points = (rotation[:, :, None, None] @ local[..., None])[..., 0] + origin[:, :, None, None]
            cameras = pinhole_cameras(
                rotation, origin, renderable(lens_of(rays) + rays.new_tensor([0, 0, 0.5, 0.5]), size), size
            )
        return Geometry(cameras, local[..., 2], 1 + raw[..., 4].exp(), points)

    def metric(self, token: Float[Tensor, "B C"]) -> Float[Tensor, "B 1"]:
        """Metres in a unit of distances and translations, from the scale token."""
        return self.scale(token).float().exp().clamp_min(1e-8)
