"""How style is read, and where and how it enters a network."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.registry.pluggable import Pluggable
from anystyle.types import Site, Source, TextMatch, Tokens


class StyleEncoder(Pluggable, nn.Module, ABC):
    """Images and texts in one space.

    The constructor sets ``dim``, the space's dimensions, and ``neutral``, the prompt that stands for no style.
    """

    dim: int
    neutral: str
    unit_norm: bool = True
    """Whether all embeddings have norm 1."""
    reads_texts: bool = True
    """Whether it embeds any text; where not, only the neutral prompt, and others raise a ValueError."""
    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""

    @abstractmethod
    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of sRGB images in [0, 1] of any size; differentiable in the images."""

    @abstractmethod
    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """Embeddings of texts.

        Raises:
            ValueError: A text is empty or longer than the encoder reads.
        """

    def load_published(self, state: Mapping[str, Tensor]) -> None:
        """Load weights under their publishers' names, strictly; on the meta device it takes the tensors themselves.

        Raises:
            UserError: They do not fit, or no published weights of this encoder are known.
        """
        raise UserError(f"no published weights of a {type(self).__name__} are known; give one that anystyle wrote")

    def match_text(self, text: str) -> TextMatch | None:
        """The nearest known description to a text, and the words that are unknown; ``None`` if it cannot tell."""
        return None


class Injector(Pluggable, nn.Module, ABC):
    """How style changes tokens at one site.

    The framework passes ``dim`` (channels at the site), ``style_dim`` and the :class:`~anystyle.types.Site` as ``site``
    to a constructor that names them. At initialisation it is the identity, bit for bit; it is equivariant to the order
    of views.
    """

    runtime = ("dim", "style_dim", "site")

    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""

    @abstractmethod
    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Tokens of the same shape, grid and kind."""

    def at_scale(self, scale: float) -> "Injector | None":
        """This injector, parameters shared, for strokes ``scale`` times as large; ``None`` if it paints none."""
        return None


class Placement(Pluggable, ABC):
    """Which sites style enters, of a backbone's and :data:`anystyle.branch.COLOR`."""

    @abstractmethod
    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        """The chosen sites, in the given order.

        Raises:
            ValueError: None is left.
        """


@torch.no_grad()
def neutral_embedding(encoder: StyleEncoder) -> Float[Tensor, "1 D"]:
    """The embedding of the encoder's neutral prompt, which style directions start from."""
    return encoder.embed_texts([encoder.neutral])
