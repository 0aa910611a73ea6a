"""A capture in styles, each as its controls say."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

from jaxtyping import Float
from torch import Tensor

from anystyle.caching import LRUCache
from anystyle.inference.controls import Controls, applied
from anystyle.inference.encoding import EncodedCapture
from anystyle.inference.masks import Mask, Shown
from anystyle.inference.styles import EmbeddedStyle
from anystyle.methods.contract import Method, Progress, silent
from anystyle.types import Gaussians, StyleEmbedding


class Controlled:
    """The styles of one capture under controls; what several have in common is computed once.

    Args:
        encoded: The capture.
        method: How it takes styles; ``None`` for the single pass.
        on_progress: Told where the method is.
        keep: So many styled scenes are kept, for other controls of the same styles.
    """

    def __init__(
        self,
        encoded: EncodedCapture,
        method: Method | None = None,
        on_progress: Callable[[Progress], None] = silent,
        keep: int = 1,
    ) -> None:
        self.encoded, self.method, self.on_progress = encoded, method, on_progress
        # Beside each scene the embedding, whose identity is the key while it lives.
        self._styled: LRUCache[int, tuple[StyleEmbedding, Gaussians]] = LRUCache(keep)
        self._weights: dict[Mask, Float[Tensor, "B N"]] = {}

    @cached_property
    def unstyled(self) -> Gaussians:
        """The reconstruction itself."""
        return self.encoded.unstyled()

    def gaussians(self, style: EmbeddedStyle) -> Gaussians:
        """The scene in a style, as its controls say."""
        controls = style.controls
        if controls.strength == 0:
            return self.unstyled
        embedding = style.embedding
        _, styled = self._styled.get(id(embedding), lambda: (embedding, self._restyled(style)))
        if controls == replace(Controls(), scale=controls.scale):
            return styled
        if styled.means.shape != self.unstyled.means.shape:
            raise ValueError("this method adds Gaussians, and controls mix those there were; set method.split_every=0")
        return applied(controls, self.unstyled, styled, self._mask_weights(controls.mask))

    def _restyled(self, style: EmbeddedStyle) -> Gaussians:
        return self.encoded.restyle(style, self.method, self.on_progress)

    def _mask_weights(self, mask: Mask | None) -> float | Float[Tensor, "B N"]:
        if mask is None:
            return 1.0
        if mask not in self._weights:
            encoded = self.encoded
            shown = Shown(encoded.sources, encoded.cameras, encoded.stylizer.renderer)
            self._weights[mask] = mask.weights(self.unstyled, shown)
        return self._weights[mask]
