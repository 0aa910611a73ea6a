"""From photographs to tokens: DINOv2, then attention across all views and within each in turn."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, run, start_as_dino
from anystyle.types import Features, Inject, Site, Tokens, untouched
from anystyle_backbones.dino import by_view, patch_tokens

STEM = -1
"""The layer of features that goes into the first block."""


class Embedder(contracts.Embedder):
    """DINOv2's first blocks; the class token stays as it is, and patches are normalised.

    The norm is the one behind which the published network adds what is known of depth and cameras; here nothing is.
    Options are explained at :class:`~anystyle_backbones.mapanything.MapAnything`. ``grid`` is in patches.

    Source: ``MapAnything._encode_n_views`` and ``_encode_and_fuse_optional_geometric_inputs``
    (``mapanything/models/mapanything/model.py``).
    """

    def __init__(self, dim: int, blocks: Iterable[Block], *, patch_size: int, grid: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        self.cls_token = nn.Parameter(torch.empty(1, 1, dim))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(dim, eps=1e-6)
        nn.init.normal_(self.cls_token, std=0.02)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        start_as_dino(self.blocks)

    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        tokens = patch_tokens(images, self.proj, self.cls_token, self.pos_embed)
        for block in self.blocks:
            tokens = tokens.with_data(by_view(block, tokens.data))
        return tokens.with_data(torch.cat([tokens.data[:, :, :1], self.norm(tokens.patches)], dim=2))


class Aggregator(contracts.Aggregator):
    """Blocks that attend across all views where their index is even, and within each view where it is odd.

    A token of the scene's scale takes part where views see each other. Nothing tells tokens where they are but the
    embedder's positions; to all tokens of the first view, the reference, a vector is added. Style may enter ahead of
    every block, on the views' tokens; marked as tapped are the first block and those whose output heads read.

    A tapped feature is the normalised stream, ahead of which stands the scale token, the same in every view; that of
    layer -1 is the stem. Options are explained at :class:`~anystyle_backbones.mapanything.MapAnything`.

    Source: ``MultiViewAlternatingAttentionTransformerIFR`` of UniCeption
    (``uniception/models/info_sharing/alternating_attention_transformer.py``).
    """

    reference: Tensor

    def __init__(self, dim: int, blocks: Iterable[Block], *, taps: Sequence[int], checkpointing: bool) -> None:
        super().__init__()
        self.dim, self.taps, self.checkpointing = dim, tuple(taps), checkpointing
        self.scale_token = nn.Parameter(torch.empty(dim))
        self.register_buffer("reference", torch.arange(dim)[None] % 2.0)  # sines and cosines of position 0
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(dim, eps=1e-6)
        nn.init.trunc_normal_(self.scale_token, std=0.02)
        start_as_dino(self.blocks)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``aggregator/<block>``, ahead of every block."""
        return tuple(
            Site(f"aggregator/{layer}", self.dim, tapped=layer == 0 or layer in self.taps)
            for layer in range(len(self.blocks))
        )

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features."""
        batch, views = stem.data.shape[:2]
        apply = partial(run, recompute=self.checkpointing and self.training)
        scale = self.scale_token.to(stem.data.dtype).expand(batch, 1, -1)
        first = stem.data[:, :1] + self.reference.to(stem.data.dtype)
        tokens = stem.with_data(torch.cat([first, stem.data[:, 1:]], dim=1))
        features = {STEM: stem} if STEM in self.taps else {}
        for layer, block in enumerate(self.blocks):
            tokens = inject(f"aggregator/{layer}", tokens)
            if layer % 2:
                tokens = tokens.with_data(by_view(partial(apply, block), tokens.data))
            else:
                joint = apply(block, torch.cat([tokens.data.flatten(1, 2), scale], dim=1))  # B VP+1 C
                tokens, scale = tokens.with_data(joint[:, :-1].unflatten(1, (views, -1))), joint[:, -1:]
            if layer in self.taps:
                joined = torch.cat([scale[:, None].expand(-1, views, -1, -1), tokens.data], dim=2)
                features[layer] = replace(tokens, data=self.norm(joined), special=tokens.special + 1)
        return features
