"""The style encoder: the backbone's own DINOv2, whose tokens of a style image the style aggregator reads."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.nn.attention import Block
from anystyle.nn.tokens import grid_of, normalised
from anystyle.types import Tokens
from anystyle.vision.preprocess import middle_square, resized
from anystyle_backbones.anysplat.networks import DinoV2
from anystyle_backbones.style_images import StyleImages
from anystyle_backbones.stylos.keys import StylosCheckpoints

PATCH, GREY = 14, 112
"""Sides in pixels of a patch, and of the grey picture that stands for no style."""


class StylosStyle(StyleImages):
    """Style images as the tokens of DINOv2 ViT-L/14 with registers, the one in Stylos; it reads no texts.

    The vector of an image is the mean of its tokens, and that of the neutral prompt a mid-grey picture's.

    Args:
        resolution: Side in pixels of the square that images are brought to, as published: by their shorter side, then
            cut to the middle. ``None`` takes them as they are, with sides that are multiples of 14.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        dim: Channels of the tokens.
        depth: Blocks.
        heads: Attention heads.
        neutral: The prompt that stands for no style, the only text.
    """

    network = "Stylos"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"resolution": 28, "native_resolution": 28, "dim": 32, "depth": 1, "heads": 2}

    def __init__(
        self,
        *,
        resolution: int | None = 448,
        native_resolution: int = 518,
        dim: int = 1024,
        depth: int = 24,
        heads: int = 16,
        neutral: str = "a grey picture",
    ) -> None:
        super().__init__()
        if resolution is not None and resolution % PATCH:
            raise UserError(f"resolution is {resolution}, which is not a multiple of {PATCH}")
        self.dim, self.token_dim, self.neutral = dim, dim, neutral
        self.resolution = resolution
        block = partial(Block, dim, heads, mlp_ratio=4.0, layer_scale=1.0, eps=1e-6)
        blocks = (block() for _ in range(depth))
        self.patches = DinoV2(dim, blocks, patch_size=PATCH, grid=native_resolution // PATCH)

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        """The patches' tokens of sRGB images in [0, 1], brought to the resolution unless they have it."""
        side = self.resolution
        if side is not None and images.shape[-2:] != (side, side):
            images = middle_square(resized(images, side, mode="bicubic")).clamp(0, 1)
        return self._tokens(images)

    def grey_tokens(self) -> Tokens:
        return self._tokens(self.patches.pos_embed.new_full((1, 3, GREY, GREY), 0.5))

    def _tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        tokens = self.patches(normalised(images.to(self.patches.pos_embed.dtype)))
        return Tokens(tokens[:, None], grid_of(images, PATCH))

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        StylosCheckpoints().load("style_encoder", self, state)
