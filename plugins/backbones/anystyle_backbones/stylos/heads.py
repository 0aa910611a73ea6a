"""Geometry of Gaussians from the aggregator, colours from the style aggregator, and the style branch."""

import copy
from collections.abc import Sequence
from dataclasses import replace

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.contracts import StylePredictor, style_tokens
from anystyle.nn.tokens import normalised
from anystyle.types import Attributes, Features, Inject, Scene, Site, StyleEmbedding, untouched
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import decoded_maps
from anystyle_backbones.stylos.transformer import SITES, STEM, StyleAggregator


class GaussianHead(contracts.GaussianHead):
    """One raw Gaussian per pixel, in the colours that the style branch gives it in the style of view 0.

    The published network has no colours without a style; its validation shows these.

    Args:
        dpt: Decodes opacity (1), scale (3), quaternion xyzw (4) and the confidence (1) that weighs pixels in fusion.
        direct: Features of the ImageNet-normalised images that are added to the decoded map, as in the demo's network.
        style_aggregator: See there.
        style_head: Decodes what it gives: red, green and blue of the constant harmonic, and a confidence that nothing
            reads.
        taps: The layers that ``dpt`` reads, four, in rising order.
        chunk: Views decoded at a time, which changes memory only.
    """

    def __init__(
        self,
        dpt: Dpt,
        direct: nn.Module | None,
        style_aggregator: StyleAggregator,
        style_head: Dpt,
        *,
        taps: Sequence[int],
        chunk: int,
    ) -> None:
        super().__init__()
        self.dpt, self.direct = dpt, direct
        self.style_aggregator, self.style_head = style_aggregator, style_head
        self.taps, self.chunk = tuple(taps), chunk

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/style_aggregator/<layer>``, tokens of the views ahead of every layer of the style aggregator."""
        dim, taps = self.style_aggregator.register_token.shape[-1], (0, *self.style_aggregator.taps)
        layers = range(len(self.style_aggregator.layers))
        return tuple(Site(f"{SITES}/{layer}", dim, tapped=layer in taps) for layer in layers)

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        stem, size = features[STEM], (images.shape[-2], images.shape[-1])
        first = replace(stem, data=stem.patches[:, :1], special=0)
        color = decoded_maps(self.style_head, self.style_aggregator(stem, first, inject), size, chunk=self.chunk)
        return replace(self.without_colors(features, images), color=color[..., :3, None])

    def without_colors(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Attributes:
        def direct(chosen: slice) -> Float[Tensor, "M E H W"]:
            assert self.direct is not None
            return F.relu_(self.direct(normalised(images[:, chosen].flatten(0, 1).to(self.dpt.dtype))))

        levels, size = [features[layer] for layer in self.taps], (images.shape[-2], images.shape[-1])
        raw = decoded_maps(self.dpt, levels, size, chunk=self.chunk, direct=None if self.direct is None else direct)
        return Attributes(
            opacity=raw[..., 0],
            scale=raw[..., 1:4],
            rotation=raw[..., 4:8],
            color=raw.new_zeros(*raw.shape[:-1], 3, 1),
            confidence=raw[..., 8],
        )


class StylosBranch(StylePredictor):
    """Colours in the style of an image, by copies of what the Gaussian head computes those in the style of view 0 with.

    Geometry, opacities and fusion do not depend on the style. A further style costs the style aggregator and its head.

    Args:
        head: What to copy from; left as it is.
    """

    styled = ("color",)
    sh_degree = 0
    reads_tokens = True
    reads_colors = False

    def __init__(self, head: GaussianHead) -> None:
        super().__init__()
        self.chunk = head.chunk
        self.aggregator = copy.deepcopy(head.style_aggregator).requires_grad_()
        self.gaussian_head = copy.deepcopy(head.style_head).requires_grad_()
        self.injectors = nn.ModuleDict()

    def forward(self, scene: Scene, embedding: StyleEmbedding) -> Attributes:
        assert self.aggregator is not None and isinstance(self.gaussian_head, Dpt)
        levels = self.aggregator(scene.stem, style_tokens(embedding))
        color = decoded_maps(self.gaussian_head, levels, scene.views.size, chunk=self.chunk)
        return replace(scene.attributes, color=color[..., :3, None])
