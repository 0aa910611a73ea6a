"""A reconstruction network of a few thousand parameters: every part of a backbone, and no more."""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Adapter, Aggregator, Backbone, Embedder, GaussianHead, GeometryHead
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.types import Attributes, Cameras, Clusters, Features, Gaussians, Geometry, Inject, Site, Tokens, untouched


class ToyEmbedder(Embedder):
    """One convolution per patch; the mean of a view's patches is its camera token."""

    def __init__(self, *, dim: int, patch_size: int) -> None:
        super().__init__()
        self.patches = nn.Conv2d(3, dim, patch_size, stride=patch_size)

    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        maps = self.patches(images.flatten(0, 1) * 2 - 1)  # BV C h w
        patches = maps.flatten(2).mT.unflatten(0, images.shape[:2])  # B V hw C
        camera = patches.mean(2, keepdim=True)
        return Tokens(torch.cat([camera, patches], dim=2), grid=(maps.shape[-2], maps.shape[-1]), special=1)


class ToyAggregator(Aggregator):
    """In each layer a token learns from itself and from the mean of its scene; heads read the first and the last."""

    def __init__(self, *, dim: int, depth: int) -> None:
        super().__init__()
        self.dim, self.taps = dim, (0, depth - 1)
        self.layers = nn.ModuleList(nn.Sequential(nn.Linear(2 * dim, dim), nn.GELU()) for _ in range(depth))

    @property
    def sites(self) -> tuple[Site, ...]:
        return tuple(Site(f"aggregator/{i}", self.dim, tapped=i in self.taps) for i in range(len(self.layers)))

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        tokens, features = stem, {}
        for index, layer in enumerate(self.layers):
            tokens = inject(f"aggregator/{index}", tokens)
            scene = tokens.data.mean((1, 2), keepdim=True).expand_as(tokens.data)
            tokens = tokens.with_data(tokens.data + layer(torch.cat([tokens.data, scene], dim=-1)))
            if index in self.taps:
                features[index] = tokens
        return features


class ToyGeometryHead(GeometryHead):
    """Cameras that look ahead from where each view's camera token says, depth and confidence from its patches."""

    def __init__(self, *, dim: int, patch_size: int) -> None:
        super().__init__()
        self.patch_size = patch_size
        self.position = nn.Linear(dim, 3)
        self.depth = nn.Linear(dim, 2 * patch_size**2)

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        (batch, number), (height, width) = images.shape[:2], images.shape[-2:]
        tokens = features[max(features)]
        poses = torch.eye(4).to(tokens.data).repeat(batch, number, 1, 1)
        poses[..., :3, 3] = 0.1 * self.position(tokens.data[:, :, 0])
        focal = float(max(height, width))
        intrinsics = poses.new_tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        cameras = Cameras(poses, intrinsics.repeat(batch, number, 1, 1), (height, width))
        depth, confidence = _to_pixels(self.depth(tokens.patches), tokens.grid, self.patch_size).unbind(-1)
        return Geometry(cameras=cameras, depth=2 + depth.tanh(), confidence=F.softplus(confidence))


class ToyGaussianHead(GaussianHead):
    """Attributes of each pixel from the last features, with colours that start from the photograph's."""

    def __init__(self, *, dim: int, patch_size: int) -> None:
        super().__init__()
        self.dim, self.patch_size = dim, patch_size
        self.attributes = nn.Linear(dim, 11 * patch_size**2)

    @property
    def sites(self) -> tuple[Site, ...]:
        return (Site("head/tokens", self.dim),)

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        tokens = inject("head/tokens", features[max(features)])
        raw = _to_pixels(self.attributes(tokens.patches), tokens.grid, self.patch_size)  # B V H W 11
        opacity, scale, rotation, change = raw.split([1, 3, 4, 3], dim=-1)
        color = constant_from_rgb(images.movedim(2, -1)) + change
        return Attributes(opacity=opacity[..., 0], scale=scale, rotation=rotation, color=color[..., None])


class ToyAdapter(Adapter):
    """Each pixel is a Gaussian of its own, about as large as the pixel."""

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        return None

    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        pixel = geometry.depth[..., None] / geometry.cameras.intrinsics[..., 0, 0, None, None, None]  # B V H W 1
        return Gaussians(
            means=geometry.points().flatten(1, 3),
            rotations=attributes.rotation.flatten(1, 3),
            scales=(F.softplus(attributes.scale) * pixel).flatten(1, 3),
            opacities=attributes.opacity.sigmoid().flatten(1, 3),
            harmonics=attributes.color.mT.flatten(1, 3),
        )


class ToyBackbone(Backbone):
    """A reconstruction network of a few thousand parameters.

    Args:
        dim: Channels of a token.
        depth: Layers of the aggregator.
        patch_size: Side of a patch in pixels.
    """

    def __init__(self, *, dim: int = 24, depth: int = 3, patch_size: int = 8) -> None:
        super().__init__()
        self.patch_size, self.resolution = patch_size, 4 * patch_size
        self.embedder = ToyEmbedder(dim=dim, patch_size=patch_size)
        self.aggregator = ToyAggregator(dim=dim, depth=depth)
        self.geometry_head = ToyGeometryHead(dim=dim, patch_size=patch_size)
        self.gaussian_head = ToyGaussianHead(dim=dim, patch_size=patch_size)
        self.adapter = ToyAdapter()

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"dim": 12, "depth": 2}


def _to_pixels(patches: Float[Tensor, "B V p F"], grid: tuple[int, int], side: int) -> Float[Tensor, "B V H W f"]:
    """Lay out the numbers of each patch over its pixels; ``F`` is ``f`` times the pixels of a patch."""
    return F.pixel_shuffle(patches.mT.unflatten(-1, grid), side).movedim(2, -1)
