"""What a method promises: how an encoded scene takes a style."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from anystyle.perception.sources import Source
from anystyle.registry.socket import Socket
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding


class Progress(NamedTuple):
    """Where a method is.

    Args:
        line: For people.
        thumbnail: A view as it is now, sRGB in [0, 1], where there is one.
        done: The share of the work that is done, in [0, 1], where it is known.
    """

    line: str
    thumbnail: Float[Tensor, "3 _ _"] | None = None
    done: float | None = None


def silent(progress: Progress) -> None:
    """Tell nobody."""


class Method(Socket, ABC):
    """From an encoded scene and a style to stylized Gaussians. The framework may pass ``losses``, by name."""

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks that it rests on beside the stylizer's, for reports."""
        return ()

    @abstractmethod
    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: Callable[[Progress], None] = silent,
    ) -> Gaussians:
        """Stylize one scene; it is left as it was.

        Args:
            stylizer: Encoded the scene and the style, and renders.
            scene: A batch of one.
            style: Image, text, or neither where the style is a point between two; a batch of one.
            embedding: The style as the stylizer's encoder reads it.
            on_progress: Called every few seconds.

        Returns:
            In the scene's frame, free of gradients.

        Raises:
            ValueError: The style lacks what the method reads, or the stylizer does.
        """
