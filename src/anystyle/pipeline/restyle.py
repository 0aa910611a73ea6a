"""The fourth step: an encoded capture in a style, as its controls say."""

from dataclasses import fields, replace
from functools import cached_property

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.pipeline.controls import Controls, Mask, SeenScene, applied
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.styles import EmbeddedStyle
from anystyle.types import Gaussians, OnProgress, Scene, StyleEmbedding, no_progress


class Restyler:
    """Gives one capture its styles; what several of them share is computed once.

    ``keep`` styled scenes stay in memory, to apply other controls to them.
    """

    def __init__(self, encoded: EncodedCapture, method: Method, keep: int = 1) -> None:
        self.encoded, self.method = encoded, method
        # The identity of an embedding is the key; the entry holds it, so that the identity stays unique.
        self._styled: LRUCache[int, tuple[StyleEmbedding, Gaussians]] = LRUCache(keep)
        self._weights: dict[Mask, Float[Tensor, "B N"]] = {}

    @cached_property
    def unstyled(self) -> Gaussians:
        """The reconstruction itself."""
        return _finite(self.encoded.gaussians(self.encoded.stylizer.unstyled), "the unstyled scene")

    def __call__(self, style: EmbeddedStyle, on_progress: OnProgress = no_progress) -> Gaussians:
        """The scene in a style; ``on_progress`` is called every few seconds while the method works."""
        controls = style.controls
        if controls.strength == 0:
            return self.unstyled
        embedding = style.embedding
        _, styled = self._styled.get(id(embedding), lambda: (embedding, self._restyle(style, on_progress)))
        if controls == replace(Controls(), scale=controls.scale):
            return styled
        if styled.means.shape != self.unstyled.means.shape:
            raise UserError("controls need a fixed number of Gaussians, and this method adds some; leave them out")
        return applied(controls, self.unstyled, styled, self.mask_weights(controls.mask))

    def _restyle(self, style: EmbeddedStyle, on_progress: OnProgress) -> Gaussians:
        stylizer = self.encoded.stylizer
        given = style.style.to(stylizer.device)

        def restyle(scene: Scene) -> Gaussians:
            return self.method(stylizer, scene, given, style.embedding, on_progress=on_progress)

        return _finite(self.encoded.gaussians(restyle), f"the scene in the style {style.title}")

    def mask_weights(self, mask: Mask | None) -> float | Float[Tensor, "B N"]:
        """How much of a style each Gaussian takes; computed once a mask."""
        if mask is None:
            return 1.0
        if mask not in self._weights:
            seen = SeenScene(self.encoded.sources, self.encoded.cameras, self.encoded.stylizer.renderer)
            self._weights[mask] = mask.weights(self.unstyled, seen)
        return self._weights[mask]


def _finite(gaussians: Gaussians, what: str) -> Gaussians:
    """The same Gaussians, or a UserError if a number is not finite: formats would store NaN silently."""
    for item in fields(gaussians):
        values: Tensor = getattr(gaussians, item.name)
        lost = values.numel() - int(values.isfinite().sum())
        if lost:
            raise UserError(
                f"{lost} of {values.numel()} numbers of the {item.name} of {what} are NaN or infinite. `anystyle "
                "plugins check backbone NAME` finds where a backbone of your own makes them; trained weights may need "
                "precision=fp32"
            )
    return gaussians
