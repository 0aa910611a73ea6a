"""The depth at which half of what a pixel shows lies in front: a backdrop behind a surface does not move it."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.types import Cameras, Gaussians

PLANES = 32
"""Between two of these the opacity that is accumulated is interpolated; as many Gaussians lie between any two."""


@torch.no_grad()
def median_depth(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> Float[Tensor, "1 V H W"]:
    """The median along z of what each view of one scene shows; 0 where it shows less than half of anything.

    The opacity in front of a plane is that of a render of the Gaussians whose centres lie in front of it.
    """
    depths = []
    for view in range(cameras.intrinsics.shape[1]):
        camera = cameras.select([view])
        pose = camera.camera_from_world[0, 0]
        z = gaussians.means[0] @ pose[2, :3] + pose[2, 3]
        planes = z[z > 0].quantile(torch.linspace(0, 1, PLANES).to(z))
        parts = (replace(gaussians, opacities=gaussians.opacities * (z <= plane)) for plane in planes)
        alpha = torch.cat([renderer(part, camera).alpha[0] for part in parts])
        after = (alpha < 0.5).sum(0).clamp(1, PLANES - 1)
        low, high = (alpha.gather(0, places[None])[0] for places in (after - 1, after))
        share = ((0.5 - low) / (high - low).clamp_min(1e-6)).clamp(0, 1)
        depths.append(planes[after - 1].lerp(planes[after], share).where(alpha[-1] >= 0.5, 0))
    return torch.stack(depths)[None]
