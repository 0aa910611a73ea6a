"""How style is read, and where and how it enters a network; what predicts styled attributes."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.registry.catalog import Pluggable
from anystyle.types import Attributes, Scene, Site, Source, StyleEmbedding, TextMatch, Tokens


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

    token_dim: int | None = None
    """Channels of the tokens of a style image, where it gives them."""

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens | None:
        """The tokens of sRGB images in [0, 1] of any size, each as one view; ``None`` if it gives vectors alone."""
        return None

    def embed_both(self, images: Float[Tensor, "M 3 H W"]) -> tuple[Float[Tensor, "M D"], Tokens | None]:
        """Embeddings and tokens of images; override it where one pass gives both."""
        return self.embed_images(images), self.embed_tokens(images)

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
    to a constructor that names them. One that ``reads_tokens`` is given the tokens of a style image in place of its
    vector, and their channels as ``style_dim``. At initialisation it is the identity, bit for bit; it is equivariant to
    the order of views.
    """

    runtime = ("dim", "style_dim", "site")

    reads_tokens: ClassVar[bool] = False

    sources: tuple[Source, ...] = ()
    """The published weights that the constructor filled it with, where it does."""

    @abstractmethod
    def forward(self, tokens: Tokens, style: Float[Tensor, "B *tokens D"]) -> Tokens:
        """Tokens of the same shape, grid and kind."""

    def at_scale(self, scale: float) -> "Injector | None":
        """This injector, parameters shared, for strokes ``scale`` times as large; ``None`` if it paints none."""
        return None


class StylePredictor(nn.Module, ABC):
    """Predicts styled attributes for an encoded scene (paper, equations 5 and 6).

    The constructor sets what is declared here. :class:`anystyle.branch.StyleBranch` is the paper's, for any backbone;
    :meth:`Backbone.make_branch <anystyle.contracts.Backbone.make_branch>` gives the one that a backbone was published
    with.
    """

    styled: tuple[str, ...]
    """The attributes that are taken from it, of ``opacity, scale, rotation, color``."""
    sh_degree: int
    """Degree of the styled colours."""
    aggregator: nn.Module | None
    """What lets the views of a scene see the style together, if it has such a part."""
    gaussian_head: nn.Module | None
    """What predicts attributes from features; ``None`` if it colours pixels alone."""
    injectors: nn.ModuleDict
    """The injectors by their sites."""
    reads_tokens: bool = False
    """Whether it reads the tokens of style images."""
    reads_colors: bool = True
    """Whether it reads the unstyled colours; a single pass leaves them out where it does not."""

    @property
    def sources(self) -> tuple[Source, ...]:
        """The published weights that its parts started from, each once."""
        return ()

    @property
    def paints_strokes(self) -> bool:
        """Whether the scale of an embedding changes what is painted."""
        return False

    @abstractmethod
    def forward(self, scene: Scene, embedding: StyleEmbedding) -> Attributes:
        """The attributes of ``scene`` in each style; scenes and styles are paired row by row.

        Raises:
            UserError: The embedding lacks the tokens that it reads.
        """


def style_tokens(embedding: StyleEmbedding) -> Tokens:
    """The tokens of a style; a UserError where it is a text, or its encoder gives vectors alone."""
    if embedding.tokens is None:
        raise UserError("this model reads the tokens of a style image; give images, and a style encoder of such tokens")
    return embedding.tokens


class Placement(Pluggable, ABC):
    """Which sites style enters, of a backbone's and :data:`anystyle.branch.COLOR`."""

    @abstractmethod
    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        """The chosen sites, in the given order.

        Raises:
            ValueError: None is left.
        """


_neutral: WeakKeyDictionary[StyleEncoder, tuple[list[object], Tensor]] = WeakKeyDictionary()


@torch.no_grad()
def neutral_embedding(encoder: StyleEncoder) -> Float[Tensor, "1 D"]:
    """The embedding of the encoder's neutral prompt, where style directions start; computed once for frozen weights."""
    weights = [*encoder.parameters(), *encoder.buffers()]
    # Tensors made in inference mode have no count of changes: they cannot change.
    state: list[object] = [encoder.neutral]
    state += [(w.data_ptr(), 0 if w.is_inference() else w._version, w.device, w.dtype) for w in weights]
    kept = _neutral.get(encoder)
    if kept is None or kept[0] != state or any(w.requires_grad for w in weights):
        kept = _neutral[encoder] = state, encoder.embed_texts([encoder.neutral])
    return kept[1].clone()
