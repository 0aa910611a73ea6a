"""The transformers: an encoder of single images, a decoder whose views meet by cross-attention, and the stylizer."""

import logging
import math
from collections.abc import Mapping
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Attention, Block, Mlp, attended
from anystyle.nn.tokens import Rotary, constant, grid_of, grid_positions, rotary, rotate
from anystyle.types import Cameras, Features, Inject, Site, Tokens, untouched
from anystyle_backbones.blocks import start_as_dino

_log = logging.getLogger(__name__)

EPSILON = 1e-6
"""Of all layer norms."""


def angles_of(tokens: Tokens, *, dim: int, base: float) -> Rotary:
    """Angles of a view's tokens: patches count from (0, 0), special tokens stand below the first column."""
    places = grid_positions(tokens.grid, tokens.special, tokens.data.device) - 1
    places[: tokens.special] = constant((float(tokens.grid[0]), 0.0), places.device, places.dtype)
    return rotary(places, dim, base=base, like=tokens.data)


def symmetric(images: Float[Tensor, "*batch 3 H W"]) -> Float[Tensor, "*batch 3 H W"]:
    """Images of [0, 1] in [-1, 1]."""
    return (images - 0.5) / 0.5


class ImageEncoder(nn.Module):
    """A vision transformer on single images, without a class token.

    Args:
        dim: Channels.
        patch_size: Pixels per patch.
        depth: Blocks.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layers, in ``dim``.
        rope_base: Base of the frequencies of the rotary position embedding.
    """

    def __init__(
        self, dim: int, *, patch_size: int, depth: int, heads: int, mlp_ratio: float, rope_base: float
    ) -> None:
        super().__init__()
        self.patch_size = patch_size
        self.angles_of = partial(angles_of, dim=dim // heads, base=rope_base)
        self.patches = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        block = partial(Block, dim, heads, mlp_ratio=mlp_ratio, layer_scale=None, eps=EPSILON)
        self.blocks = nn.ModuleList(block() for _ in range(depth))
        self.norm = nn.LayerNorm(dim, eps=EPSILON)
        start_as_dino(self.blocks)

    def forward(self, images: Float[Tensor, "B V 3 H W"], special: Float[Tensor, "B V s C"] | None = None) -> Tokens:
        """Tokens of images as they are (nothing is normalised), behind ``special`` ones."""
        grid = grid_of(images, self.patch_size)
        data = self.patches(images.flatten(0, 1).to(self.patches.weight.dtype)).flatten(2).mT
        data = data.unflatten(0, images.shape[:2])
        data = data if special is None else torch.cat([special.to(data.dtype), data], dim=2)
        tokens = Tokens(data, grid, special=0 if special is None else special.shape[2])
        x, angles = data.flatten(0, 1), self.angles_of(tokens)
        for block in self.blocks:
            x = block(x, angles)
        return tokens.with_data(self.norm(x).unflatten(0, images.shape[:2]))


class Embedder(contracts.Embedder):
    """Pixels in [-1, 1] and the entries of the intrinsics, in units of the image, through an encoder of single views.

    A view's intrinsics are its special token. Options are explained at :class:`~anystyle_backbones.styl3r.Styl3r`.
    """

    reads_cameras = True

    def __init__(self, encoder: ImageEncoder, *, field_of_view: float) -> None:
        super().__init__()
        self.encoder, self.field_of_view = encoder, field_of_view
        self.intrinsics = nn.Linear(9, encoder.patches.out_channels)
        self._told = False

    def forward(self, images: Float[Tensor, "B V 3 H W"], cameras: Cameras | None = None) -> Tokens:
        """Embed sRGB images in [0, 1]; without cameras, ``field_of_view`` is taken for that of every view."""
        units = self._assumed(images) if cameras is None else cameras.resized((1, 1)).intrinsics.to(images)
        entries = units.flatten(-2).to(self.intrinsics.weight.dtype)
        return self.encoder(symmetric(images), self.intrinsics(entries)[:, :, None])

    def _assumed(self, images: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V 3 3"]:
        if not self._told:
            self._told = True
            _log.info(
                "the network reads intrinsics, and none are given: a field of view of %g degrees along the shorter "
                "side is assumed; backbone.field_of_view sets another",
                self.field_of_view,
            )
        height, width = images.shape[-2:]
        focal = min(height, width) / 2 / math.tan(math.radians(self.field_of_view) / 2)
        entries = (focal / width, 0.0, 0.5, 0.0, focal / height, 0.5, 0.0, 0.0, 1.0)
        return constant(entries, images.device, images.dtype).view(3, 3).expand(*images.shape[:2], 3, 3)


def tapped(depth: int) -> tuple[int, int, int, int]:
    """How many blocks are behind a decoder's tokens where heads read them."""
    return 0, depth // 2, depth * 3 // 4, depth


class Decoder(nn.Module):
    """What both decoders have: a linear map of the encoder's tokens, and the norm of their last output.

    Features are by the number of blocks behind them: 0 are the tokens given, the last are normalised.
    """

    def __init__(self, dim: int, width: int, *, depth: int, heads: int, rope_base: float) -> None:
        super().__init__()
        self.width, self.taps = width, tapped(depth)
        self.embed = nn.Linear(dim, width)
        self.norm = nn.LayerNorm(width, eps=EPSILON)
        self.angles_of = partial(angles_of, dim=width // heads, base=rope_base)

    def features(self, given: Tokens, outputs: Mapping[int, Tokens]) -> Features:
        """What heads read, of the tokens given and of the output of every block."""
        last = outputs[self.taps[-1]]
        normed = {0: given, self.taps[-1]: last.with_data(self.norm(last.data))}
        return {layer: normed.get(layer) or outputs[layer] for layer in self.taps}


class MemoryAttention(nn.Module):
    """Multi-head attention of queries to a memory, both turned by their positions."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.projq, self.projk, self.projv, self.proj = (nn.Linear(dim, dim) for _ in range(4))

    def forward(
        self, x: Float[Tensor, "M L C"], memory: Float[Tensor, "M S C"], angles: Rotary, memory_angles: Rotary
    ) -> Float[Tensor, "M L C"]:
        pairs = ((self.projq, x), (self.projk, memory), (self.projv, memory))
        q, k, v = (project(y).unflatten(-1, (self.heads, -1)).transpose(1, 2) for project, y in pairs)
        q, k = rotate(q, angles), rotate(k, memory_angles)
        return self.proj(attended(q, k, v))


class DecoderBlock(nn.Module):
    """A pre-norm block with cross-attention to a memory after its self-attention.

    Args:
        dim: Channels.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layer, in ``dim``.
        eps: Epsilon of the layer norms.
    """

    def __init__(self, dim: int, heads: int, *, mlp_ratio: float, eps: float = 1e-5) -> None:
        super().__init__()
        self.norm1, self.norm2, self.norm3, self.norm_y = (nn.LayerNorm(dim, eps=eps) for _ in range(4))
        self.attn = Attention(dim, heads, qk_norm=False)
        self.cross_attn = MemoryAttention(dim, heads)
        self.mlp = Mlp(dim, int(dim * mlp_ratio), dim)

    def forward(
        self, x: Float[Tensor, "M L C"], memory: Float[Tensor, "M S C"], angles: Rotary, memory_angles: Rotary
    ) -> Float[Tensor, "M L C"]:
        """Tokens after the block; a memory of no tokens adds nothing."""
        x = x + self.attn(self.norm1(x), angles)
        if memory.shape[1]:
            x = x + self.cross_attn(self.norm2(x), self.norm_y(memory), angles, memory_angles)
        return x + self.mlp(self.norm3(x))


class Aggregator(Decoder, contracts.Aggregator):
    """Blocks of the first view's own and others for all other views; each view attends to all others' tokens.

    Style does not enter here. Options are explained at :class:`~anystyle_backbones.styl3r.Styl3r`.
    """

    def __init__(self, dim: int, width: int, *, depth: int, heads: int, mlp_ratio: float, rope_base: float) -> None:
        super().__init__(dim, width, depth=depth, heads=heads, rope_base=rope_base)
        block = partial(DecoderBlock, width, heads, mlp_ratio=mlp_ratio, eps=EPSILON)
        self.first, self.others = (nn.ModuleList(block() for _ in range(depth)) for _ in range(2))
        start_as_dino(self.first)
        start_as_dino(self.others)
        self._told = False

    @property
    def sites(self) -> tuple[Site, ...]:
        return ()

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features.

        The published network does not run on one view; here the view's tokens then pass its blocks without a memory.
        """
        batch, views = stem.data.shape[:2]
        if views == 1 and not self._told:
            self._told = True
            _log.warning("there is one view, and the published network needs two: what it gives is a guess")
        beside = torch.arange(views - 1, device=stem.data.device).expand(views, -1)  # V V-1
        beside = beside + torch.ones_like(beside).triu()  # all but the view itself
        angles = self.angles_of(stem)
        tokens, outputs = stem.with_data(self.embed(stem.data)), {}
        for layer, (first, others) in enumerate(zip(self.first, self.others, strict=True), start=1):
            x = tokens.data
            memory = x[:, beside].flatten(2, 3)  # B V (V-1)P C
            decoded = [first(x[:, 0], memory[:, 0], angles, angles)[:, None]]
            if views > 1:
                rest = (part[:, 1:].flatten(0, 1) for part in (x, memory))
                decoded.append(others(*rest, angles, angles).unflatten(0, (batch, views - 1)))
            tokens = outputs[layer] = tokens.with_data(torch.cat(decoded, dim=1))
        return self.features(stem, outputs)


class TokenStylizer(Decoder):
    """The tokens of all views as one sequence, which attends to itself and to the tokens of a style."""

    def __init__(self, dim: int, width: int, *, depth: int, heads: int, mlp_ratio: float, rope_base: float) -> None:
        super().__init__(dim, width, depth=depth, heads=heads, rope_base=rope_base)
        block = partial(DecoderBlock, width, heads, mlp_ratio=mlp_ratio, eps=EPSILON)
        self.blocks = nn.ModuleList(block() for _ in range(depth))
        start_as_dino(self.blocks)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/stylizer/<block>``, on the stream ahead of every block."""
        marked = {0, *(layer - 1 for layer in self.taps[1:])}
        return tuple(
            Site(f"head/stylizer/{layer}", self.width, tapped=layer in marked) for layer in range(len(self.blocks))
        )

    def forward(self, stem: Tokens, style: Tokens, inject: Inject = untouched) -> Features:
        """Features of the encoder's tokens in a style: one view of tokens of any grid for each scene."""
        dtype = self.embed.weight.dtype
        given, memory = stem.with_data(stem.data.to(dtype)), style.with_data(self.embed(style.data.to(dtype)))
        angles, memory_angles = self.angles_of(given), self.angles_of(memory)
        tokens, outputs = given.with_data(self.embed(given.data)), {}
        for layer, block in enumerate(self.blocks):
            tokens = inject(f"head/stylizer/{layer}", tokens)
            joint = block(tokens.data.flatten(1, 2), memory.data[:, 0], angles, memory_angles)
            tokens = outputs[layer + 1] = tokens.with_data(joint.unflatten(1, tokens.data.shape[1:3]))
        return self.features(given, outputs)
