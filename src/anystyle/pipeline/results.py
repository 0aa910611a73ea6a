"""The fourth step: results of a stylization, each restyled when it is asked for."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.io.sheet import thumbnails
from anystyle.pipeline.controls import Mask
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.load import LoadedModel
from anystyle.pipeline.provenance import Entry, without_folders
from anystyle.pipeline.request import Request
from anystyle.pipeline.restyle import Restyler
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import EmbeddedStyle
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle.vision.weights import license_lines, licenses

VERSIONS = {name: version(name) for name in ("anystyle", "torch", "numpy")}


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
            "weights": self.model.weights,
            "seed": self.request.seed,
            "config": without_folders(self.request.config),
            **self.recorded,
            "licenses": licenses(self.model.networks),
            "notes": encoded.notes,
            "offset": encoded.offset if any(encoded.offset) else None,
            "provenance": self.made_of([style]),
            "versions": VERSIONS,
        }
        return {name: value for name, value in report.items() if value or name not in ("controls", "texts", "offset")}


@dataclass(frozen=True)
class Result:
    """A scene in one style."""

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
