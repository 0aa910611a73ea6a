"""Style encoders that read images alone, as tokens."""

from abc import abstractmethod
from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.errors import UserError
from anystyle.types import Tokens


class StyleImages(StyleEncoder):
    """Tokens of style images, whose mean is an image's vector; of texts only the neutral prompt, a grey image, is read.

    A network's encoder sets ``network``, its name in errors.
    """

    unit_norm, reads_texts = False, False
    network: str

    @abstractmethod
    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        """Tokens of sRGB images in [0, 1]."""

    @abstractmethod
    def grey_tokens(self) -> Tokens:
        """Tokens of the grey image that stands for no style."""

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        return self.embed_both(images)[0]

    def embed_both(self, images: Float[Tensor, "M 3 H W"]) -> tuple[Float[Tensor, "M D"], Tokens]:
        tokens = self.embed_tokens(images)
        return tokens.data.mean((1, 2)), tokens

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """The vector of a grey image for the neutral prompt.

        Raises:
            UserError: Another text is given, or none.
        """
        if not texts or any(text != self.neutral for text in texts):
            other = next((text for text in texts if text != self.neutral), "")
            raise UserError(f"{other[:40]!r}: {self.network} reads style images, no texts; give an image")
        return self.grey_tokens().data.mean((1, 2)).expand(len(texts), -1)
