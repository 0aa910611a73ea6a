"""The stylizer's encoder of style pictures."""

from collections.abc import Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from anystyle.contracts import StyleEncoder
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne
from anystyle.types import Tokens
from anystyle.vision.preprocess import middle_squares
from anystyle_backbones.styl3r.keys import Styl3rCheckpoints
from anystyle_backbones.styl3r.transformer import PictureEncoder, symmetric

_KEPT: MutableMapping[Tensor, tuple[object, Tokens]] = WeakIdKeyDictionary()
"""The tokens of pictures that are in memory, with what else they depend on."""


class Styl3rStyle(StyleEncoder):
    """Tokens of a style picture, for ``model=styl3r``; its vector is their mean. It reads no texts.

    Args:
        resolution: Side of the square that pictures are brought to, their middle being kept; ``None`` leaves them as
            they are, whose sides then must be multiples of ``patch_size``.
        style_range: ``unit``: pixels enter in [0, 1], as the released inference feeds them and the weights were trained
            (by mistake, its authors say); ``symmetric``: in [-1, 1], as the released training code has it.
        neutral: The prompt that stands for no style, which is read as a grey picture.
        patch_size: Pixels per patch.
        dim: Channels.
        depth: Blocks.
        heads: Attention heads.
        mlp_ratio: Width of the feed-forward layers, in channels.
        rope_base: Base of the frequencies of the rotary position embedding.
    """

    unit_norm = False
    reads_texts = False

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
        self.encoder = PictureEncoder(dim, patch_size=patch_size, **options)
        self._grey = torch.empty(0)

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        Styl3rCheckpoints().load("style_encoder", self, state)

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        """Tokens of sRGB images in [0, 1], kept as long as the images are if they carry no gradient."""
        weight = self.encoder.norm.weight
        if torch.is_grad_enabled() and (images.requires_grad or weight.requires_grad):
            return self._tokens(images)
        state = images._version, weight.data_ptr(), weight._version, weight.dtype, self.resolution, self.style_range
        if images not in _KEPT or _KEPT[images][0] != state:
            _KEPT[images] = state, self._tokens(images)
        return _KEPT[images][1]

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """The means of the tokens of sRGB images in [0, 1]."""
        return self.embed_tokens(images).data.mean((1, 2))

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """The embedding of a grey picture for the neutral prompt.

        Raises:
            UserError: Another text is given.
        """
        if other := next((text for text in texts if text != self.neutral), None):
            raise UserError(f"{other[:40]!r}: this style encoder reads pictures alone; give an image of the style")
        if not texts or not all(texts):
            raise UserError("a text is empty; give an image of the style")
        weight, side = self.encoder.norm.weight, self.resolution or 16 * self.encoder.patch_size
        if (self._grey.device, self._grey.dtype) != (weight.device, weight.dtype) or not self._grey.numel():
            self._grey = weight.new_full((1, 3, side, side), 0.5)
        return self.embed_images(self._grey).expand(len(texts), -1)

    def _tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        squares = images if self.resolution is None else middle_squares(images, self.resolution)
        return self.encoder((squares if self.style_range == "unit" else symmetric(squares))[:, None])
