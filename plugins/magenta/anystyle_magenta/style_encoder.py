"""Pictures and texts as the numbers that steer the style transfer network."""

from collections.abc import Sequence

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.types import TextMatch
from anystyle_magenta.descriptions import Descriptions
from anystyle_magenta.prediction import SIDE, STYLE_DIM, StylePrediction
from anystyle_magenta.pretrained import load_prediction, load_text_tower
from anystyle_magenta.text_tower import TextTower


class MagentaEncoder(StyleEncoder):
    """Magenta's style prediction network, and a text tower that predicts its vectors from captions.

    Its vectors are not of unit norm, since the style transfer network depends on their lengths; they may be mixed
    linearly. The text tower is not Magenta's. It knows a few hundred words for colours, patterns, media, things and
    manners; :meth:`match_text` says which words of a text it does not know.

    Args:
        pretrained: Whether the networks have their weights (``anystyle weights list magenta_predict magenta_text``).

    Raises:
        FileNotFoundError: The package with Magenta's weights is not installed.
        UserError: The package holds another file than the published one.
    """

    unit_norm: bool = False

    def __init__(self, *, pretrained: bool = True) -> None:
        super().__init__()
        self.dim = STYLE_DIM
        self.neutral = "a photo"
        self.network = StylePrediction()
        self.text_tower = TextTower()
        self.descriptions = Descriptions()
        if pretrained:
            self.sources = (load_prediction(self.network), load_text_tower(self.text_tower))

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of the square in the middle of images, resized to 256 pixels a side; differentiable."""
        return self.network(centre_square(images))

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        return self.text_tower(texts)

    def match_text(self, text: str) -> TextMatch:
        """The nearest known description; similarity is that of the words' spelling, from 0 to 1."""
        return self.descriptions.match(text)


def centre_square(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 256 256"]:
    """The square in the middle, resized to the size that the network was trained with."""
    height, width = images.shape[-2:]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = images[..., top : top + side, left : left + side]
    if side == SIDE:
        return square
    return F.interpolate(square, size=(SIDE, SIDE), mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)
