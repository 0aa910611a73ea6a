"""The contract of a method: an encoded scene and a style to stylized Gaussians."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from anystyle.registry.pluggable import Pluggable
from anystyle.types import Gaussians, OnProgress, Scene, Source, Style, StyleEmbedding, no_progress

if TYPE_CHECKING:
    from anystyle.stylizer import Stylizer


class Method(Pluggable, ABC):
    """Stylizes one scene at a time; a constructor argument ``losses`` is passed by the framework, by name."""

    runtime = ("losses",)

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks that it uses beside the stylizer's, for reports."""
        return ()

    @abstractmethod
    def __call__(
        self,
        stylizer: "Stylizer",
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        """Stylize one scene, without changing it.

        Args:
            stylizer: Encoded the scene and the style, and renders.
            scene: A batch of one.
            style: Image, text, or neither where the style is a point between two; a batch of one.
            embedding: The style, embedded by the stylizer's encoder.
            on_progress: Called every few seconds.

        Returns:
            In the scene's frame, free of gradients.

        Raises:
            UserError: The style or the stylizer lacks what the method needs.
        """
