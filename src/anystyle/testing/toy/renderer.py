"""Round blobs: the smallest renderer that sorts, blends and can be learned through."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.types import Cameras, Gaussians, Renders

HARMONIC_0 = 0.28209479177387814


class ToyRenderer(Renderer):
    """Draw every Gaussian over the whole image, as a blob whose spread in a direction is its mean spread there.

    It knows the constant colour alone, and its cost is Gaussians times pixels: for small scenes.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are not seen.
        blur: Variance in pixels² added to every blob.
    """

    def __init__(
        self, *, background: tuple[float, float, float] = (1.0, 1.0, 1.0), near: float = 0.01, blur: float = 0.3
    ) -> None:
        self.background = background
        self.near = near
        self.blur = blur

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """See :meth:`anystyle.contracts.Renderer.__call__`."""
        scenes = [
            torch.stack([self._draw(gaussians, cameras, scene, view) for view in range(cameras.intrinsics.shape[1])])
            for scene in range(gaussians.means.shape[0])
        ]
        image = torch.stack(scenes)  # B V 5 H W
        alpha = image[:, :, 4]
        behind = image.new_tensor(self.background)[:, None, None] * (1 - alpha[:, :, None])
        return Renders(color=(image[:, :, :3] + behind).clamp(0, 1), depth=image[:, :, 3], alpha=alpha)

    def _draw(self, gaussians: Gaussians, cameras: Cameras, scene: int, view: int) -> Float[Tensor, "5 H W"]:
        pose, intrinsics = cameras.camera_from_world[scene, view], cameras.intrinsics[scene, view]
        local = gaussians.means[scene] @ pose[:3, :3].mT + pose[:3, 3]  # N 3
        depth = local[:, 2].clamp_min(self.near)
        center = (local @ intrinsics.mT)[:, :2] / depth[:, None]  # N 2
        variance = self._variance(gaussians, scene, pose) * (intrinsics[0, 0] / depth) ** 2 + self.blur  # N
        offset = _pixels(cameras.size, center) - center[:, None, None]  # N H W 2
        falloff = torch.exp(-0.5 * offset.square().sum(-1) / variance[:, None, None])
        seen = local[:, 2] > self.near
        alpha = (gaussians.opacities[scene] * seen)[:, None, None] * falloff  # N H W
        order = local[:, 2].argsort()
        alpha = alpha[order]
        passing = torch.cat([torch.ones_like(alpha[:1]), (1 - alpha).cumprod(0)[:-1]])  # what is left of the light
        color = (0.5 + HARMONIC_0 * gaussians.harmonics[scene, :, 0]).clamp_min(0)  # N 3
        shown = torch.cat([color, depth[:, None], torch.ones_like(depth[:, None])], dim=-1)[order]  # N 5
        return torch.einsum("nhw,nc->chw", alpha * passing, shown)

    def _variance(self, gaussians: Gaussians, scene: int, pose: Float[Tensor, "4 4"]) -> Float[Tensor, " N"]:
        # The mean of the two variances across the line of sight: the trace of the covariance without its z part.
        w, x, y, z = torch.nn.functional.normalize(gaussians.rotations[scene], dim=-1).unbind(-1)
        rows = [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ]  # fmt: skip
        axes = torch.stack(rows, dim=-1).unflatten(-1, (3, 3))  # N 3 3
        spread = gaussians.scales[scene].square()
        forward = ((pose[2, :3] @ axes) ** 2 * spread).sum(-1)
        return (spread.sum(-1) - forward) / 2


def _pixels(size: tuple[int, int], like: Tensor) -> Float[Tensor, "H W 2"]:
    v, u = torch.meshgrid(torch.arange(size[0]), torch.arange(size[1]), indexing="ij")
    return torch.stack([u, v], dim=-1).to(like) + 0.5
