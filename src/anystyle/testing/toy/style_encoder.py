"""Style as a palette: the mean colour of an image, or of the colours that a text names."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder

PALETTE = {
    "red": (0.8, 0.1, 0.1),
    "orange": (0.9, 0.5, 0.1),
    "green": (0.1, 0.6, 0.2),
    "blue": (0.1, 0.2, 0.8),
    "white": (0.95, 0.95, 0.95),
}


class ToyStyleEncoder(StyleEncoder):
    """Four numbers: how red, green and blue a style is beside grey, and 1.

    Args:
        neutral: The prompt that stands for no style.
        strength: How far colours are spread apart.
    """

    def __init__(self, *, neutral: str = "photo", strength: float = 4.0) -> None:
        super().__init__()
        self.dim, self.neutral, self.strength = 4, neutral, strength

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        return self._embed(images.mean((2, 3)))

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        if any(not text.strip() for text in texts):
            raise ValueError("a style text is empty; describe the style, such as 'blue and white'")
        words = [text.lower().replace(",", " ").split() for text in texts]
        named = [[PALETTE[word] for word in of_text if word in PALETTE] or [(0.5, 0.5, 0.5)] for of_text in words]
        return self._embed(torch.stack([torch.tensor(colors).mean(0) for colors in named]))

    def _embed(self, colors: Float[Tensor, "M 3"]) -> Float[Tensor, "M 4"]:
        return F.normalize(F.pad(self.strength * (colors - 0.5), (0, 1), value=1.0), dim=-1)
