"""Backbones that each break one promise, and what is found."""

from dataclasses import replace

import torch
from torch import nn

from anystyle.testing.toy.backbone import (
    ToyAdapter,
    ToyAggregator,
    ToyBackbone,
    ToyEmbedder,
    ToyGaussianHead,
    ToyGeometryHead,
)
from anystyle.types import Clusters, Gaussians, Site, untouched


def with_part(name, make):
    """A toy backbone whose part ``name`` is what ``make(dim, patch_size)`` gives."""

    class Changed(ToyBackbone):
        """A toy with another part."""

        def __init__(self, *, dim: int = 12, depth: int = 2, patch_size: int = 4):
            super().__init__(dim=dim, depth=depth, patch_size=patch_size)
            setattr(self, name, make(dim, patch_size))

    return Changed


def geometry(change):
    """A toy whose geometry is ``change`` of what it predicts."""

    class Head(ToyGeometryHead):
        def forward(self, features, images):
            return change(super().forward(features, images))

    return with_part("geometry_head", lambda dim, patch: Head(dim=dim, patch_size=patch))


def attributes(change):
    """A toy whose attributes are ``change`` of what it predicts."""

    class Head(ToyGaussianHead):
        def forward(self, features, images, inject=untouched):
            return change(super().forward(features, images, inject))

    return with_part("gaussian_head", lambda dim, patch: Head(dim=dim, patch_size=patch))


def aggregator(cls):
    """A toy with another aggregator."""
    return with_part("aggregator", lambda dim, patch: cls(dim=dim, depth=2))


class PairAdapter(ToyAdapter):
    """Fuses the two halves of all pixels one to one: right as it is, and the stem of mutants."""

    share = 0.5

    def cluster(self, geometry, attributes):
        means = geometry.points().flatten(1, 3)
        batch, pixels = means.shape[:2]
        index = (torch.arange(pixels) % (pixels // 2)).expand(batch, -1)
        weight = torch.full((batch, pixels), self.share)
        fused = torch.cat([0.5 * (means[:, : pixels // 2] + means[:, pixels // 2 :]), torch.zeros(batch, 1, 3)], dim=1)
        valid = torch.arange(fused.shape[1]).expand(batch, -1) < pixels // 2
        return Clusters(index, weight, fused, valid)

    def forward(self, attributes, geometry, clusters):
        every = super().forward(attributes, geometry, None)
        count = clusters.means.shape[1]

        def fuse(values):
            flat = values.flatten(2) if values.ndim > 2 else values[..., None]
            total = torch.zeros(flat.shape[0], count, flat.shape[2])
            weighted = flat * clusters.weight[..., None]
            summed = total.scatter_add(1, clusters.index[..., None].expand_as(weighted), weighted)
            return summed.reshape(flat.shape[0], count, *values.shape[2:])

        return Gaussians(clusters.means, *(fuse(getattr(every, name)) for name in self.fields))

    fields = ("rotations", "scales", "opacities", "harmonics")


class Unnormalised(PairAdapter):
    share = 0.7


class Padded(PairAdapter):
    def forward(self, attributes, geometry, clusters):
        fused = super().forward(attributes, geometry, clusters)
        return replace(fused, opacities=torch.where(clusters.valid, fused.opacities, 0.5))


class Logits(ToyAdapter):
    def forward(self, attributes, geometry, clusters):
        return replace(super().forward(attributes, geometry, clusters), opacities=attributes.opacity.flatten(1, 3) * 9)


class Detached(ToyAdapter):
    def forward(self, attributes, geometry, clusters):
        return super().forward(replace(attributes, opacity=attributes.opacity.detach()), geometry, clusters)


class Overrides(ToyBackbone):
    """Overrides what is final."""

    def train(self, mode=True):
        return super().train(mode)


class WithoutResolution(ToyBackbone):
    """Forgets a number."""

    def __init__(self, *, dim: int = 12):
        super().__init__(dim=dim, depth=2, patch_size=4)
        del self.resolution


class OneViewShort(ToyEmbedder):
    def forward(self, images):
        tokens = super().forward(images)
        return tokens.with_data(tokens.data / torch.tensor(float(images.shape[1] - 1)))


class Misnamed(ToyAggregator):
    @property
    def sites(self):
        return tuple(replace(site, name=site.name.replace("aggregator", "layers")) for site in super().sites)


class Narrow(ToyAggregator):
    @property
    def sites(self):
        return tuple(replace(site, dim=site.dim + 1) for site in super().sites)


class Unvisited(ToyAggregator):
    @property
    def sites(self):
        return (*super().sites, Site("aggregator/norm", self.dim))


class Ignored(ToyAggregator):
    def forward(self, stem, inject=untouched):
        def ignore(name, tokens):
            inject(name, tokens)
            return tokens

        return super().forward(stem, ignore)


class Marked(ToyAggregator):
    def forward(self, stem, inject=untouched):
        features = super().forward(stem, inject)
        if inject is untouched:
            return features
        return {layer: tokens.with_data(tokens.data * (1 + 1e-6)) for layer, tokens in features.items()}


class AcrossScenes(ToyAggregator):
    def forward(self, stem, inject=untouched):
        return super().forward(stem.with_data(stem.data - stem.data.mean(0, keepdim=True) * 0.5), inject)


class Wavering(ToyAggregator):
    calls = 0

    def forward(self, stem, inject=untouched):
        self.calls += 1
        features = super().forward(stem, inject)
        return {layer: tokens.with_data(tokens.data + 1e-3 * self.calls) for layer, tokens in features.items()}


class Overwriting(ToyEmbedder):
    def forward(self, images):
        return super().forward(images.mul_(0.5))


class SharedHead(ToyGaussianHead):
    def __deepcopy__(self, memory):
        return self


class Uncopyable(ToyGaussianHead):
    def __init__(self, **options):
        super().__init__(**options)
        self.stream = (number for number in range(3))


class Restless(nn.LayerNorm):
    def train(self, mode=True):
        return super().train(True)


def _restless():
    class Layer(ToyAggregator):
        def __init__(self, **options):
            super().__init__(**options)
            self.layers[0].norm = Restless(options["dim"])

    return Layer


def _flipped(given):
    pose = given.cameras.world_from_camera * torch.tensor([-1.0, 1.0, 1.0, 1.0])
    return replace(given, cameras=replace(given.cameras, world_from_camera=pose))


def _turned(given):
    return replace(given, cameras=replace(given.cameras, size=given.cameras.size[::-1]))


CHANGED = {
    "as it is": (ToyBackbone, set()),
    "fuses pixels": (with_part("adapter", lambda dim, patch: PairAdapter()), set()),
    "a part of another class": (with_part("adapter", lambda *_: nn.Identity()), {"all five parts are there"}),
    "no resolution": (WithoutResolution, {"all five parts are there"}),
    "train is overridden": (Overrides, {"final methods are left alone"}),
    "sites of another name": (aggregator(Misnamed), {"sites are named after their part"}),
    "an axis too many": (
        attributes(lambda given: replace(given, opacity=given.opacity[..., None])),
        {"encodes two views"},
    ),
    "integers for depth": (geometry(lambda given: replace(given, depth=given.depth.int())), {"encodes two views"}),
    "undefined for one view": (
        with_part("embedder", lambda dim, patch: OneViewShort(dim=dim, patch_size=patch)),
        {"encodes a single view"},
    ),
    "width before height": (geometry(_turned), {"encodes every shape"}),
    "scenes of a batch mixed": (aggregator(AcrossScenes), {"encodes several scenes at once"}),
    "double precision": (
        geometry(lambda given: replace(given, confidence=given.confidence.double())),
        {"dtypes are kept"},
    ),
    "NaN": (
        geometry(lambda given: replace(given, depth=(given.depth - 2).log())),
        {"numbers are finite", "attributes carry gradients"},
    ),
    "mirrored cameras": (geometry(_flipped), {"cameras are rigid pinholes"}),
    "negative confidence": (
        geometry(lambda given: replace(given, confidence=-1 - given.confidence)),
        {"confidence is not negative"},
    ),
    "weights that sum to more than 1": (
        with_part("adapter", lambda *_: Unnormalised()),
        {"pixels share gaussians fairly", "gaussians are renderable"},
    ),
    "visible padding": (with_part("adapter", lambda *_: Padded()), {"gaussians are renderable"}),
    "logits for opacities": (with_part("adapter", lambda *_: Logits()), {"gaussians are renderable"}),
    "a site too many": (
        aggregator(Unvisited),
        {"every site is visited", "injected tokens are used"},
    ),
    "wrong channels": (aggregator(Narrow), {"every site is visited"}),
    "inject's answer unused": (aggregator(Ignored), {"injected tokens are used"}),
    "inject noticed": (aggregator(Marked), {"untouched sites change nothing"}),
    "overwritten images": (
        with_part("embedder", lambda dim, patch: Overwriting(dim=dim, patch_size=patch)),
        {"encoding twice is the same", "encodes several scenes at once", "copies compute the same"},
    ),
    "state between calls": (
        aggregator(Wavering),
        {
            "encodes several scenes at once",
            "untouched sites change nothing",
            "encoding twice is the same",
            "copies compute the same",
        },
    ),
    "copies that are none": (
        with_part("gaussian_head", lambda dim, patch: SharedHead(dim=dim, patch_size=patch)),
        {"copies compute the same"},
    ),
    "a part that cannot be copied": (
        with_part("gaussian_head", lambda dim, patch: Uncopyable(dim=dim, patch_size=patch)),
        {"copies compute the same"},
    ),
    "a layer that does not go to eval": (aggregator(_restless()), {"freezing is for good"}),
    "opacity without gradient": (with_part("adapter", lambda *_: Detached()), {"attributes carry gradients"}),
}
