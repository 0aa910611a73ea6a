"""Round blobs: the smallest renderer that sorts, blends and is differentiable."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import colors
from anystyle.geometry.projection import covariances
from anystyle.types import Cameras, Gaussians, Renders


class ToyRenderer(Renderer):
    """Draw every Gaussian over the whole image, as a blob whose spread in a direction is its mean spread there.

    At a cost of Gaussians times pixels: for small scenes.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are not seen.
        blur: Variance in pixels² added to every blob.
    """

    def __init__(
        self, *, background: tuple[float, float, float] = (1.0, 1.0, 1.0), near: float = 0.01, blur: float = 0.3
    ) -> None:
        self.background, self.near, self.blur = background, near, blur

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        scenes, views = cameras.intrinsics.shape[:2]
        drawn = [self._draw(gaussians, cameras, scene, view) for scene in range(scenes) for view in range(views)]
        image = torch.stack(drawn).unflatten(0, (scenes, views))  # B V 5 H W
        alpha = image[:, :, 4]
        behind = image.new_tensor(self.background)[:, None, None] * (1 - alpha[:, :, None])
        return Renders(color=(image[:, :, :3] + behind).clamp(0, 1), depth=image[:, :, 3], alpha=alpha)

    def _draw(self, gaussians: Gaussians, cameras: Cameras, scene: int, view: int) -> Float[Tensor, "5 H W"]:
        pose, intrinsics = cameras.camera_from_world[scene, view], cameras.intrinsics[scene, view]
        local = gaussians.means[scene] @ pose[:3, :3].mT + pose[:3, 3]  # N 3
        depth = local[:, 2].clamp_min(self.near)
        center = (local @ intrinsics.mT)[:, :2] / depth[:, None]  # N 2
        # The mean of the two variances across the line of sight: the trace of the covariance without its z part.
        spread = covariances(gaussians.rotations[scene], gaussians.scales[scene])  # N 3 3
        across = spread.diagonal(dim1=-2, dim2=-1).sum(-1) - pose[2, :3] @ spread @ pose[2, :3]
        sharp = across / 2 * (intrinsics[0, 0] / depth) ** 2  # N
        variance = sharp + self.blur
        opacities = gaussians.opacities[scene] * (sharp / variance if gaussians.antialiased else 1.0)
        v, u = torch.meshgrid(torch.arange(cameras.size[0]), torch.arange(cameras.size[1]), indexing="ij")
        offset = torch.stack([u, v], dim=-1).to(center) + 0.5 - center[:, None, None]  # N H W 2
        falloff = torch.exp(-0.5 * offset.square().sum(-1) / variance[:, None, None])
        order = local[:, 2].argsort()
        alpha = ((opacities * (local[:, 2] > self.near))[:, None, None] * falloff)[order]  # N H W
        passing = torch.cat([torch.ones_like(alpha[:1]), (1 - alpha).cumprod(0)[:-1]])  # what is left of the light
        away = normalize(gaussians.means[scene] - cameras.world_from_camera[scene, view, :3, 3], dim=-1)
        color = colors(gaussians.harmonics[scene], away)  # N 3
        shown = torch.cat([color, depth[:, None], torch.ones_like(depth[:, None])], dim=-1)[order]  # N 5
        return torch.einsum("nhw,nc->chw", alpha * passing, shown)
