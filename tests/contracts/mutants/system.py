"""Compositions of a backbone and an injector that each break one promise, and what is found."""

from dataclasses import replace

import torch
from torch import nn

from anystyle.testing.toy.backbone import ToyAdapter, ToyBackbone, ToyEmbedder, ToyGaussianHead
from anystyle.testing.toy.injector import ToyInjector
from anystyle.types import untouched

from .backbone import SharedHead, with_part
from .injector import Born, Deaf, Mixed, Unused


class SpareHead(ToyGaussianHead):
    def __init__(self, **options):
        super().__init__(**options)
        self.spare = nn.Linear(3, 3)


class CountingHead(ToyGaussianHead):
    calls = 0

    def forward(self, features, images, inject=untouched):
        self.calls += 1
        given = super().forward(features, images, inject)
        return replace(given, rotation=given.rotation + 1e-3 * self.calls)


class ColorsAsScales(ToyAdapter):
    def forward(self, attributes, geometry, clusters):
        brightness = attributes.color.mean((-1, -2))[..., None]
        return super().forward(replace(attributes, scale=attributes.scale + 0.1 * brightness), geometry, clusters)


class Forgetful(ToyInjector):
    def __init__(self, *, dim: int, style_dim: int):
        super().__init__(dim=dim, style_dim=style_dim)
        self.register_buffer("basis", torch.randn(style_dim, style_dim), persistent=False)

    def forward(self, tokens, style):
        return super().forward(tokens, style @ self.basis)


class Transposed(ToyEmbedder):
    def forward(self, images):
        tokens = super().forward(images)
        return tokens.with_data(tokens.data.mT.contiguous().mT)


def head(cls):
    return with_part("gaussian_head", lambda dim, patch: cls(dim=dim, patch_size=patch))


CHANGED = {
    "as they are": (ToyBackbone, ToyInjector, set()),
    "tokens in another order of memory": (
        with_part("embedder", lambda dim, patch: Transposed(dim=dim, patch_size=patch)),
        ToyInjector,
        set(),
    ),
    "not the identity": (ToyBackbone, Born, {"nothing changes at birth"}),
    "a layer of the injector too many": (ToyBackbone, Unused, {"everything learns by the second step"}),
    "a layer of the head too many": (head(SpareHead), ToyInjector, {"everything learns by the second step"}),
    "a head that is not copied": (
        head(SharedHead),
        ToyInjector,
        {"the backbone does not learn", "everything learns by the second step"},
    ),
    "style unused": (ToyBackbone, Deaf, {"style matters after training"}),
    "scales from colours": (
        with_part("adapter", lambda *_: ColorsAsScales()),
        ToyInjector,
        {"what is not styled stays"},
    ),
    "a head that counts": (
        head(CountingHead),
        ToyInjector,
        {
            "nothing changes at birth",
            "encoding once is the single pass",
            "many styles are one batch",
            "weights name their sites",
        },
    ),
    "styles of a batch mixed": (ToyBackbone, Mixed, {"many styles are one batch"}),
    "weights that are not kept": (ToyBackbone, Forgetful, {"weights name their sites"}),
}
