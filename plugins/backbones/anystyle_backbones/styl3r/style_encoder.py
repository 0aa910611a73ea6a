"""The stylizer's encoder of style images."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne
from anystyle.types import Tokens
from anystyle.vision.preprocess import middle_squares
from anystyle_backbones.styl3r.keys import Styl3rCheckpoints
from anystyle_backbones.styl3r.transformer import ImageEncoder, symmetric


class Styl3rStyle(StyleEncoder):
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
        self.encoder = ImageEncoder(dim, patch_size=patch_size, **options)

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        Styl3rCheckpoints().load("style_encoder", self, state)

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        """Tokens of sRGB images in [0, 1]."""
        squares = images if self.resolution is None else middle_squares(images, self.resolution)
        return self.encoder((squares if self.style_range == "unit" else symmetric(squares))[:, None])

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """The means of the tokens of sRGB images in [0, 1]."""
        return self.embed_both(images)[0]

    def embed_both(self, images: Float[Tensor, "M 3 H W"]) -> tuple[Float[Tensor, "M D"], Tokens]:
        tokens = self.embed_tokens(images)
        return tokens.data.mean((1, 2)), tokens

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """The embedding of a grey image for the neutral prompt.

        Raises:
            UserError: Another text is given.
        """
        if other := next((text for text in texts if text != self.neutral), None):
            raise UserError(f"{other[:40]!r}: Styl3R reads style images, no texts; give an image")
        if not texts or not all(texts):
            raise UserError("a text is empty; give an image of the style")
        side = self.resolution or 16 * self.encoder.patch_size
        grey = self.encoder.norm.weight.new_full((1, 3, side, side), 0.5)
        return self.embed_images(grey).expand(len(texts), -1)
