"""Gaussians to begin a fit with: pixels of the photographs, lifted to their depth."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn.functional import pad

from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.types import Cameras, Gaussians, Value
from anystyle_captures.stereo import StereoDepth

BACKDROP = 3.0
"""The backdrop, such as sky, lies behind nearly all known depths by this factor."""
SURROUND = 1.0
"""The backdrop extends beyond every photograph by this fraction of its sides: views from elsewhere see past them."""
NEIGHBORS = 3
"""The scale of a Gaussian is a fraction of the mean distance to this many nearest ones."""
SURFACE, OVERLAP = 0.7, 1.4
"""That fraction, and that of the backdrop, which is to be opaque where no photograph teaches it."""
OPACITY, OPAQUE = 0.4, 0.9
"""The opacity of a Gaussian at the start, and that of one of the backdrop: where no photograph teaches it, it stays."""


@dataclass(frozen=True)
class InitialGaussians(Value):
    """Isotropic Gaussians at pixels of photographs."""

    means: Float[Tensor, "N 3"]
    scales: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    footprints: Float[Tensor, " N"]
    pixels: Int[Tensor, "N 3"]

    def gaussians(self, degree: int) -> Gaussians:
        """The same with everything that a fit changes."""
        colors = constant_from_rgb(self.colors)[:, None]
        return Gaussians(
            means=self.means[None],
            rotations=self.means.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(1, len(self.means), 1),
            scales=self.scales[None, :, None].repeat(1, 1, 3),
            opacities=self.opacities[None],
            harmonics=pad(colors, (0, 0, 0, (degree + 1) ** 2 - 1))[None],
        )


def from_stereo(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    stereo: StereoDepth,
    *,
    num_gaussians: int,
    unsupported: float,
    generator: torch.Generator,
) -> InitialGaussians:
    """Lift pixels of all views, evenly over the images: those of supported depth, and a fraction of the others."""
    lifted = (stereo.support >= 1) | (torch.rand(stereo.support.shape, generator=generator) < unsupported)
    lifted &= stereo.depth.isfinite()
    fraction = float(lifted.double().mean())
    if not bool((stereo.support >= 1).any()):
        raise UserError("no depth is supported by a second view: nothing to begin a fit with")
    num_views, height, width = images.shape[0], images.shape[-2], images.shape[-1]
    stride = max(1.0, (num_views * height * width * fraction / num_gaussians) ** 0.5)
    offsets = torch.rand(num_views, 2, generator=generator) * stride
    pixels = []
    for view in range(num_views):
        rows = torch.arange(float(offsets[view, 0]), height, stride).long()
        columns = torch.arange(float(offsets[view, 1]), width, stride).long()
        y, x = (grid.flatten() for grid in torch.meshgrid(rows, columns, indexing="ij"))
        keep = lifted[view, y, x]
        pixels.append(torch.stack([torch.full_like(y, view), y, x], dim=1)[keep])
    chosen = torch.cat(pixels)
    return lift(images, cameras, stereo.depth[chosen.unbind(1)], chosen)


def backdrop(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    stereo: StereoDepth,
    *,
    num_gaussians: int,
    generator: torch.Generator,
) -> InitialGaussians:
    """Large Gaussians behind everything, at pixels whose depth no view supports: sky, and what is too far or plain.

    As many lie around the photographs, in the colours of their borders; there are none at or beside masked pixels.
    """
    valid, (views, height, width) = ~stereo.depth.isnan(), stereo.depth.shape
    bottom, right = round(SURROUND * height), round(SURROUND * width)
    ranges = (0, views), (-bottom, height + bottom), (-right, width + right)
    # Far more than are taken, for those within photographs and beside masked pixels are left out.
    view, y, x = (torch.randint(*ends, (16 * num_gaussians,), generator=generator) for ends in ranges)
    within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    beside = valid[view, y.clamp(0, height - 1), x.clamp(0, width - 1)]
    around = torch.stack([view, y, x], dim=1)[~within & beside][:num_gaussians]
    pixels = torch.cat([_drawn((stereo.support < 1) & valid, num_gaussians, generator), around])
    depth = torch.full((len(pixels),), farthest(stereo))
    return lift(images, cameras, depth, pixels, largest=float("inf"), fraction=OVERLAP, opacity=OPAQUE)


def farthest(stereo: StereoDepth) -> float:
    """The depth of the backdrop."""
    known = stereo.depth[stereo.support >= 1]
    return BACKDROP * float(known[:: max(1, len(known) // 1_000_000)].quantile(0.98))


def _drawn(mask: Bool[Tensor, "V H W"], count: int, generator: torch.Generator) -> Int[Tensor, "N 3"]:
    """At most ``count`` random pixels where a mask is true; flat indices, since it may have many millions."""
    drawn = torch.randperm(int(mask.sum()), generator=generator)[:count].clone()  # lets go of the others
    drawn = mask.flatten().nonzero().flatten()[drawn]
    return torch.stack(torch.unravel_index(drawn, mask.shape), dim=1)


def lift(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    depth: Float[Tensor, " N"],
    pixels: Int[Tensor, "N 3"],
    largest: float = 6.0,
    fraction: float = SURFACE,
    opacity: float = OPACITY,
) -> InitialGaussians:
    """Gaussians at pixels of known depth, as large as the gaps between them."""
    view, y, x = pixels.unbind(1)
    z = depth.double()
    image = torch.stack([x + 0.5, y + 0.5, torch.ones_like(z)], dim=1)
    pose, inverse = cameras.world_from_camera[0].double(), torch.linalg.inv(cameras.intrinsics[0].double())
    local = torch.einsum("nij,nj->ni", inverse[view], image) * z[:, None]
    means = torch.einsum("nij,nj->ni", pose[view, :3, :3], local) + pose[view, :3, 3]
    footprints = z / cameras.intrinsics[0, view, 0, 0].double()
    distances, _ = KDTree(means.numpy()).query(means.numpy(), k=min(NEIGHBORS + 1, len(means)))
    gaps = torch.from_numpy(distances).view(len(means), -1)[:, 1:].mean(1).nan_to_num(1.0)
    y, x = y.clamp(0, images.shape[-2] - 1), x.clamp(0, images.shape[-1] - 1)
    return InitialGaussians(
        means=means.float(),
        scales=(fraction * gaps.clamp(0.5 * footprints, largest * footprints)).float(),
        colors=images[view, :, y, x],
        opacities=torch.full_like(gaps, opacity, dtype=torch.float32),
        footprints=footprints.float(),
        pixels=torch.stack([view, y, x], dim=1),
    )
