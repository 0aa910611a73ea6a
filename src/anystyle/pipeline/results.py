"""The fourth step: an encoded capture in its styles, each result computed when it is asked for."""

import inspect
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from math import isqrt
from typing import Any

from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.heap import keep_freed
from anystyle.io.cache import LRUCache
from anystyle.io.record import versions
from anystyle.io.sheet import thumbnails
from anystyle.pipeline.controls import Controls, Mask, SeenScene, applied
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.load import LoadedModel
from anystyle.pipeline.provenance import Entry, without_folders
from anystyle.pipeline.request import Request
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import EmbeddedStyle
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, OnProgress, Scene, StyledScene, StyleEmbedding, no_progress
from anystyle.types.shapes import check_value
from anystyle.vision.weights import license_lines, licenses

_log = logging.getLogger(__name__)


class Restyler:
    """Gives one capture its styles; what several of them share is computed once.

    ``keep`` styled scenes stay in memory, to apply other controls to them.
    """

    def __init__(self, encoded: EncodedCapture, method: Method, keep: int = 1) -> None:
        self.encoded, self.method = encoded, method
        # The identity of an embedding is the key; the entry holds it, so that the identity stays unique.
        self._styled: LRUCache[int, tuple[StyleEmbedding, Gaussians]] = LRUCache(keep)
        self._told = False
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
        keep_freed(8 << 20)  # less than the pictures that are painted

        def restyle(scene: Scene) -> Gaussians:
            styled = self.method(stylizer, scene, given, style.embedding, on_progress=on_progress)
            check_value(styled, Gaussians, f"the method {type(self.method).__qualname__}", B=1)
            return styled

        styled = _finite(self.encoded.gaussians(restyle), f"the scene in the style {style.title}")
        before = self.encoded.groups[0].scene.gaussians
        if before is not None and styled.harmonics.shape[2] < before.harmonics.shape[2] and not self._told:
            keeps, self._told = "keep_harmonics" in inspect.signature(type(self.method)).parameters, True
            remedy, degree = "; method.keep_harmonics=true keeps them" if keeps else "", before.harmonics.shape[2]
            _log.warning("harmonics of degree 1 to %d of the given scene are dropped%s", isqrt(degree) - 1, remedy)
        return styled

    def mask_weights(self, mask: Mask | None) -> float | Float[Tensor, "B N"]:
        """How much of a style each Gaussian takes; computed once a mask."""
        if mask is None:
            return 1.0
        if mask not in self._weights:
            seen = SeenScene(self.encoded.sources, self.encoded.cameras, self.encoded.stylizer.renderer)
            self._weights[mask] = mask.weights(self.unstyled, seen)
            if not self._weights[mask].any():
                middle = self.unstyled.means[0].median(0).values.tolist()
                _log.warning("the mask %s holds none of the Gaussians, whose median is %s", mask.text, middle)
        return self._weights[mask]


def _finite(gaussians: Gaussians, what: str) -> Gaussians:
    """The same Gaussians, or a UserError if a number is not finite: formats would store NaN silently."""
    for item in fields(gaussians):
        values: Tensor = getattr(gaussians, item.name)
        lost = values.numel() - int(values.isfinite().sum())
        if lost:
            raise UserError(
                f"{lost} of {values.numel()} numbers of the {item.name} of {what} are NaN or infinite. `anystyle "
                "plugins check KIND NAME` finds where a backbone or method of your own makes them; trained weights may "
                "need precision=fp32"
            )
    return gaussians


@dataclass(frozen=True)
class StylizeRun:
    """What the results of one stylization share.

    Args:
        restyler: Holds the capture, and gives it styles.
        model: What was loaded.
        request: What was asked for.
        recorded: For reports, the words that ask for it and their digest.
        stages: Times the work.
    """

    restyler: Restyler
    model: LoadedModel
    request: Request
    recorded: Mapping[str, object]
    stages: Stages

    @property
    def encoded(self) -> EncodedCapture:
        """The views that the scene was made from, with their sources and cameras."""
        return self.restyler.encoded

    @property
    def unstyled(self) -> Gaussians:
        """The scene itself."""
        return self.restyler.unstyled

    def made_of(self, styles: Sequence[EmbeddedStyle]) -> list[Entry]:
        """What the scene in these styles was made of, each once."""
        entries = [*self.encoded.made_of, *(entry for style in styles for entry in style.made_of)]
        return [entry for index, entry in enumerate(entries) if entry not in entries[:index]]

    def scene(
        self, styles: Sequence[tuple[str, Gaussians]], embedded: Sequence[EmbeddedStyle], title: str = ""
    ) -> StyledScene:
        """The scene in some styles, as files hold it."""
        encoded = self.encoded
        lines = dict.fromkeys([*license_lines(licenses(self.model.networks)), *encoded.notes])
        return StyledScene(
            tuple(styles),
            encoded.cameras,
            tuple(encoded.names),
            (title, *lines) if title else tuple(lines),
            title,
            offset=encoded.offset,
            pictures=pictures(embedded),
            photographed=encoded.photographed,
        )

    def report(self, style: EmbeddedStyle, gaussians: Gaussians) -> dict[str, Any]:
        """What was run on what, for ``report.json``."""
        encoded, method = self.encoded, self.model.method
        count = int((gaussians.opacities > 0).sum())
        report: dict[str, Any] = {
            "style": style.title,
            "controls": style.controls.label,
            "texts": [asdict(match) for match in style.matches],
            "gaussians": count,
            "views": len(encoded.sources),
            "groups": len(encoded.groups),
            "reconstruction": {**encoded.reconstruction, "num_gaussians": count},
            "method": {
                "kind": catalog().name_of("method", type(method)),
                "networks": [asdict(source) for source in method.sources],
            },
            "inputs": [source.name for source in encoded.sources],
            "size": list(encoded.views.size),
            **self.stages.report(),
            "precision": encoded.stylizer.precision,
            "weights": self.model.weights,
            "seed": self.request.seed,
            "config": without_folders(self.request.config),
            **self.recorded,
            "licenses": licenses(self.model.networks),
            "notes": encoded.notes,
            "offset": encoded.offset if any(encoded.offset) else None,
            "provenance": self.made_of([style]),
            "versions": versions(),
        }
        return {name: value for name, value in report.items() if value or name not in ("controls", "texts", "offset")}


@dataclass(frozen=True)
class Result:
    """A scene in one style.

    Results share tensors with one another and with the unstyled scene: edit ``gaussians.map(torch.clone)``, not these.
    """

    style: EmbeddedStyle
    gaussians: Gaussians
    run: StylizeRun

    @property
    def encoded(self) -> EncodedCapture:
        """The views it was made from, with their sources and cameras."""
        return self.run.encoded

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the frame of the Gaussians."""
        return self.encoded.cameras

    @property
    def report(self) -> dict[str, Any]:
        """What was run on what, for ``report.json``."""
        return self.run.report(self.style, self.gaussians)

    def shares(self, names: Sequence[str]) -> bool:
        """Whether these attributes of Gaussians are those of the unstyled scene; some methods move or add Gaussians."""
        return self.gaussians.shares(self.run.unstyled, names)

    def weights(self, mask: Mask) -> float | Float[Tensor, "B N"]:
        """How much of a style each Gaussian takes under a mask, in [0, 1]; what ``controls.blended`` reads."""
        return self.run.restyler.mask_weights(mask)

    def scene(self, shared: Sequence[str] = ()) -> StyledScene:
        """The Gaussians for a file of styles that share attributes: before this one the unstyled, if they are its."""
        styles = [("unstyled", self.run.unstyled)] if self.shares(shared) else []
        return self.run.scene([*styles, (self.style.title, self.gaussians)], [self.style], self.style.title)

    def render(self, cameras: Cameras | None = None) -> Iterator[Float[Tensor, "3 H W"]]:
        """Render views one by one, on the CPU; the input views unless cameras are given."""
        return self.encoded.render(self.gaussians, cameras)


class Results:
    """The results of several styles, each computed on access; none is kept in memory.

    :func:`anystyle.save` writes them.

    Args:
        run: What they share.
        styles: The styles, at least one.
    """

    def __init__(self, run: StylizeRun, styles: Sequence[EmbeddedStyle]) -> None:
        self.run, self.styles = run, tuple(styles)

    def __len__(self) -> int:
        return len(self.styles)

    def __getitem__(self, index: int) -> Result:
        style = self.styles[index]
        note = f"{range(len(self))[index] + 1}/{len(self)}: {' '.join(style.title.split())[:70]}"
        with self.run.stages("restyle", note) as on_progress:
            return Result(style, self.run.restyler(style, on_progress), self.run)

    def __iter__(self) -> Iterator[Result]:
        for index in range(len(self)):
            yield self[index]

    @property
    def encoded(self) -> EncodedCapture:
        """The views they are made from, with their sources and cameras."""
        return self.run.encoded


def pictures(styles: Sequence[EmbeddedStyle]) -> dict[str, Image.Image]:
    """Small pictures of the styles that are images, by title."""
    return {style.title: thumbnails([style.cell])[0] for style in styles if isinstance(style.cell, Image.Image)}
