"""The stylizer's encoder of style images."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.ranges import AtLeastOne
from anystyle.types import Tokens
from anystyle.vision.preprocess import as_pillow
from anystyle_backbones.styl3r.keys import Styl3rCheckpoints
from anystyle_backbones.styl3r.transformer import ImageEncoder, symmetric
from anystyle_backbones.style_images import StyleImages


class Styl3rStyle(StyleImages):
    """Tokens of a style image, for ``model=styl3r``; its vector is their mean. It reads no texts.

    Args:
        resolution: Side of the square that images are brought to, their middle being kept; ``None`` leaves them as
            they are, whose sides then must be multiples of ``patch_size``.
        style_range: ``unit``: pixels enter in [0, 1], as the released inference feeds them and the weights were trained
            (by mistake, its authors say); ``symmetric``: in [-1, 1], as the released training code has it.
        neutral: The prompt that stands for no style, which is read as a grey image.
        patch_size: Pixels per patch.
        dim: Channels.
        depth: Blocks.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layers, in channels.
        rope_base: Base of the frequencies of the rotary position embedding.
    """

    network = "Styl3R"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"resolution": 32, "dim": 32, "depth": 2, "heads": 2}

    def __init__(
        self,
        *,
        resolution: AtLeastOne | None = 256,
        style_range: Literal["unit", "symmetric"] = "unit",
        neutral: str = "a photo",
        patch_size: int = 16,
        dim: int = 1024,
        depth: int = 24,
        heads: int = 16,
        mlp_ratio: float = 4.0,
        rope_base: float = 100.0,
    ) -> None:
        super().__init__()
        self.dim = self.token_dim = dim
        self.neutral, self.resolution, self.style_range = neutral, resolution, style_range
        options = {"depth": depth, "heads": heads, "mlp_ratio": mlp_ratio, "rope_base": rope_base}
        self.encoder = ImageEncoder(dim, patch_size=patch_size, **options)

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        Styl3rCheckpoints().load("style_encoder", self, state)

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        squares = images if self.resolution is None else middle_squares(images, self.resolution)
        return self.encoder((squares if self.style_range == "unit" else symmetric(squares))[:, None])

    def grey_tokens(self) -> Tokens:
        side = self.resolution or 16 * self.encoder.patch_size
        return self.embed_tokens(self.encoder.norm.weight.new_full((1, 3, side, side), 0.5))


def middle_squares(images: Float[Tensor, "M 3 H W"], side: int) -> Float[Tensor, "M 3 S S"]:
    """The middle of images in [0, 1] whose shorter side is brought to ``side``; those of this size stay as they are.

    They are resized as published, by Pillow's Lanczos kernel on 8 bits; where the images carry a gradient, by a cubic
    kernel with antialiasing, which has one.
    """
    height, width = images.shape[-2:]
    if (height, width) == (side, side):
        return images
    longer = int(max(height, width) / min(height, width) * side)
    shape = (side, longer) if height <= width else (longer, side)
    if images.requires_grad and torch.is_grad_enabled():
        scaled = F.interpolate(images, size=shape, mode="bicubic", antialias=True, align_corners=False)
    else:
        scaled = as_pillow(images, shape, Image.Resampling.LANCZOS)
    top, left = (round((length - side) / 2) for length in shape)
    return scaled[..., top : top + side, left : left + side]
