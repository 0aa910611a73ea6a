"""The last two steps: results of a stylization, restyled one at a time when they are asked for, and their files."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError, one_line
from anystyle.formats import comments
from anystyle.io import ply
from anystyle.io.atomic import atomic_directory, write_json
from anystyle.io.sheet import Cell, save_png, style_sheet, thumbnails, to_pil
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.film import Film
from anystyle.pipeline.load import LoadedModel
from anystyle.pipeline.provenance import Entry, without_folders
from anystyle.pipeline.request import Request
from anystyle.pipeline.restyle import Restyler
from anystyle.pipeline.saved import PICTURE, save_gaussians, write_cameras, write_colmap
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import EmbeddedStyle
from anystyle.pipeline.words import digest, recorded
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, Renders, SourceImage, StyledScene
from anystyle.vision.weights import license_lines, licenses

VERSIONS = {name: version(name) for name in ("anystyle", "torch", "numpy")}
WRITTEN = "scene, renders and video"
"""The progress line while a result is written."""

Column = tuple[str, Cell, Sequence[Cell]]
"""Of a sheet: title, style image if there is one, renders as small as its cells."""


@dataclass(frozen=True)
class Result:
    """A scene in one style."""

    style: EmbeddedStyle
    gaussians: Gaussians
    results: "Results"

    @property
    def encoded(self) -> EncodedCapture:
        """The views it was made from, with their sources and cameras."""
        return self.results.encoded

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the frame of the Gaussians."""
        return self.encoded.cameras

    def shares(self, names: Sequence[str]) -> bool:
        """Whether these attributes of Gaussians are those of the unstyled scene; some methods move or add Gaussians."""
        return self.gaussians.shares(self.results.restyler.unstyled, names)

    @property
    def report(self) -> dict[str, object]:
        """What was run on what, for ``report.json``."""
        encoded, results, style = self.encoded, self.results, self.style
        count = int((self.gaussians.opacities > 0).sum())
        report = {
            "style": style.title,
            "controls": style.controls.label,
            "texts": [asdict(match) for match in style.matches],
            "gaussians": count,
            "views": len(encoded.sources),
            "groups": len(encoded.groups),
            "reconstruction": {**encoded.reconstruction, "num_gaussians": count},
            "method": results.method,
            "inputs": [source.name for source in encoded.sources],
            "size": list(encoded.views.size),
            **results.stages.report(),
            **results.provenance,
            "licenses": licenses(results.networks),
            "notes": encoded.notes,
            "offset": encoded.offset if any(encoded.offset) else None,
            "provenance": results.made_of([style]),
            "versions": VERSIONS,
        }
        for name in ("controls", "texts", "offset"):
            if not report[name]:
                del report[name]
        return report

    def scene(self, shared: Sequence[str] = ()) -> StyledScene:
        """The Gaussians for a file of styles that share attributes: before this one the unstyled, if they are its."""
        styles = [("unstyled", self.results.restyler.unstyled)] if self.shares(shared) else []
        return self.results.scene([*styles, (self.style.title, self.gaussians)], [self.style], self.style.title)

    def render(self, cameras: Cameras | None = None) -> Iterator[Float[Tensor, "3 H W"]]:
        """Render views one by one, on the CPU; the input views unless cameras are given."""
        return self.encoded.render(self.gaussians, cameras)

    def save(self, folder: str | Path) -> None:
        """Write all files of this result; those of the same names are replaced, whole or not at all."""
        with atomic_directory(folder) as temporary, self.results.stages("write", WRITTEN):
            self.write(temporary)
        self.results.check_written(Path(folder), temporary)

    def write(self, folder: Path) -> Column:
        """Write all files into a folder that has none of them, and return the column of a sheet over several styles."""
        column = (self.style.title, self.style.cell, thumbnails(self._write_scene(folder)))
        for picture in _pictures([self.style]).values():
            picture.save(folder / PICTURE, quality=90)
        self.results.write_sheet(folder, [*self.results.before, column])
        write_json(folder / "report.json", self.report)
        return column

    def _write_scene(self, folder: Path) -> list[Image.Image]:
        gaussians, encoded, results, options = self.gaussians, self.encoded, self.results, self.results.export
        folder.mkdir(parents=True, exist_ok=True)
        scene, given, as_given = self.scene(), encoded.splat, ("means", "rotations", "scales", "opacities")
        # A trip through float32 logarithms and back moves the last bits.
        kept = options.up in (None, "opencv") and self.shares(as_given)
        source = given if kept and given is not None and given.suffix.lower() == ".ply" else None
        if source is None or not ply.recolor(source, gaussians.harmonics[0], folder / "scene.ply", comments(scene)):
            export_styles(scene, folder / "scene.ply", "ply", up=options.up)
        for name, kind in results.formats.items():
            if not (name in results.common_formats and self.shares(kind.shared)):
                results.export_scene(self.scene(kind.shared), folder / f"scene.{name}", name)
        save_gaussians(gaussians, folder / "scene.safetensors")
        renders = self._write_renders(folder / "renders", encoded.names, self.cameras, encoded.sources)
        names, followed = encoded.targets or (encoded.names, self.cameras)
        if encoded.targets is not None:
            self._write_renders(folder / "targets", names, followed)
        seen = encoded.photographed and encoded.targets is None
        film = StyledScene(((self.style.title, gaussians),), followed, tuple(names), photographed=seen)
        results.video.write(film, folder / "video.mp4", results.render_until_given_up)
        cameras, sources = encoded.cameras.to("cpu"), encoded.sources
        write_cameras(folder / "cameras.json", cameras, sources, encoded.offset, encoded.scene_from_known)
        if options.colmap != "none":
            write_colmap(folder / "sparse" / "0", gaussians, cameras, sources, binary=options.colmap == "binary")
        return renders

    def _write_renders(
        self, folder: Path, names: Sequence[str], cameras: Cameras, sources: Sequence[SourceImage] = ()
    ) -> list[Image.Image]:
        folder.mkdir()
        renders = _pictures_of(self.render(cameras), sources)
        for name, image in zip(names, renders, strict=True):
            save_png(image, folder / f"{name}.png")
        return renders


class Results:
    """The results of several styles, each computed on access; none is kept in memory.

    Args:
        encoded: The capture.
        styles: The styles, at least one.
        model: Takes them.
        request: Says which files a result has, and what is filmed.
        stages: Times the work.
    """

    def __init__(
        self,
        encoded: EncodedCapture,
        styles: Sequence[EmbeddedStyle],
        model: LoadedModel,
        request: Request,
        stages: Stages,
    ) -> None:
        self.restyler = Restyler(encoded, model.method)
        self.export, self.stages = request.export, stages
        self.encoded, self.styles = encoded, tuple(styles)
        own = [asdict(source) for source in model.method.sources]
        self.method = {"kind": catalog().name_of("method", type(model.method)), "networks": own}
        self.networks = model.weights | {entry["network"]: entry for entry in own if entry["file"]}
        self.provenance = {
            "weights": model.weights,
            "seed": request.seed,
            "config": without_folders(request.config),
            "request": recorded(request) if model.named else None,
            "request_sha256": digest(request) if model.named else None,
        }
        self.video = Film(request.video)
        self.given_up = False
        """Whether a film that is being written in a thread will not be needed."""
        self.failed: list[tuple[Path, str]] = []
        """Files that formats could not write, and why; all others are written."""
        self.bug: Exception | None = None
        """The first of these errors that no format should raise."""

    def render_until_given_up(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """The render of a film, unless it will not be needed."""
        if self.given_up:
            raise KeyboardInterrupt
        return self.encoded.stylizer.render(gaussians, cameras)

    def __len__(self) -> int:
        return len(self.styles)

    def __getitem__(self, index: int) -> Result:
        style = self.styles[index]
        note = f"{range(len(self))[index] + 1}/{len(self)}: {' '.join(style.title.split())[:70]}"
        with self.stages("restyle", note) as on_progress:
            return Result(style, self.restyler(style, on_progress), self)

    def __iter__(self) -> Iterator[Result]:
        for index in range(len(self)):
            yield self[index]

    def save(self, folder: str | Path) -> None:
        """Write all results and what they have in common; files of the same names are replaced, all or none.

        A single result lies in the folder itself, several in folders of their own beside a sheet of all.
        """
        with atomic_directory(folder) as temporary:
            self.write(temporary)
        self.check_written(Path(folder), temporary)

    def export_scene(self, scene: StyledScene, path: Path, name: str) -> None:
        """Write a scene as a file of a format, or note that the format cannot: a result is whole without it."""
        try:
            export_styles(scene, path, name, up=self.export.up)
        except OSError:  # no room is left, for other files neither
            raise
        except Exception as error:  # a bug of a plugin is raised in the end: hours of work may lie behind the results
            # As text: a traceback would keep the Gaussians of every style in memory.
            self.failed.append((path, one_line(error)))
            if self.bug is None and not isinstance(error, (UserError, ImportError)):
                self.bug = error

    def check_written(self, folder: Path, temporary: Path) -> None:
        """Raise what formats could not write of a folder, once ``temporary``: a UserError, or the bug of one."""
        failed, bug, self.failed, self.bug = self.failed, self.bug, [], None
        if failed:
            lines = "; ".join(f"{path.relative_to(temporary)}: {reason}" for path, reason in failed)
            told = f"{lines}; not written, and all else is in {folder}"
            if bug is None:
                raise UserError(told)
            bug.add_note(told)
            raise bug

    def write(self, folder: Path) -> None:
        """Write all results into a folder that has none of their files."""
        written: list[Future[Column]] = []
        columns, styles = [*self.before], [("unstyled", self.restyler.unstyled)]
        report: dict[str, object] = {}
        # A result is rendered and encoded in a thread while the next one is computed: memory holds two, and no film.
        with ThreadPoolExecutor(1) as thread:
            try:
                for index in range(len(self)):
                    result = self[index]
                    if written:
                        self._wait(written)
                    inside = folder if len(self) == 1 else folder / f"{index + 1:02d}-{result.style.name}"
                    written.append(thread.submit(result.write, inside))
                    report = result.report
                    if any(result.shares(kind.shared) for kind in self.common_formats.values()):
                        styles.append((result.style.title, result.gaussians))
                columns += self._wait(written)
            except BaseException:
                self.given_up = True
                raise
        with self.stages("write", "what the styles have in common"):
            save_gaussians(self.restyler.unstyled, folder / "unstyled.safetensors")
            if len(self) > 1:
                self.write_sheet(folder, columns)
            for name, kind in self.common_formats.items():
                alike = [each for each in styles if each[1].shares(self.restyler.unstyled, kind.shared)]
                if len(alike) > 1:
                    self.export_scene(self.scene(alike, self.styles), folder / f"scene.{name}", name)
        if len(self) > 1:
            common = {"style": [style.title for style in self.styles], "provenance": self.made_of(self.styles)}
            write_json(folder / "report.json", report | self.stages.report() | common)

    def _wait(self, written: Sequence[Future[Column]]) -> list[Column]:
        with self.stages("write", WRITTEN):
            return [future.result() for future in written]

    @cached_property
    def formats(self) -> dict[str, type[Format]]:
        """The formats of a scene beside PLY."""
        return {name: catalog().find("format", name).load() for name in self.export.formats if name != "ply"}

    @cached_property
    def common_formats(self) -> dict[str, type[Format]]:
        """The formats whose file holds several styles: one lies beside the sheet, with all that share what it asks."""
        return {name: kind for name, kind in self.formats.items() if kind.many_styles and len(self) > 1}

    def made_of(self, styles: Sequence[EmbeddedStyle]) -> list[Entry]:
        """What the scene in these styles was made of, each once."""
        entries = [*self.encoded.made_of, *(entry for style in styles for entry in style.made_of)]
        return [entry for index, entry in enumerate(entries) if entry not in entries[:index]]

    def scene(
        self, styles: Sequence[tuple[str, Gaussians]], embedded: Sequence[EmbeddedStyle], title: str = ""
    ) -> StyledScene:
        """The scene in styles, as files hold it."""
        encoded, names = self.encoded, tuple(self.encoded.names)
        lines = tuple(dict.fromkeys((*license_lines(licenses(self.networks)), *encoded.notes)))
        notes = (title, *lines) if title else lines
        shared, pictures = (encoded.cameras, names, notes, title), _pictures(embedded)
        return StyledScene(
            tuple(styles), *shared, offset=encoded.offset, pictures=pictures, photographed=encoded.photographed
        )

    def write_sheet(self, folder: Path, columns: Sequence[Column]) -> None:
        """Write ``sheet.png``: photographs, or of a given scene the renders that are its views, and some columns."""
        title = "photograph" if self.before else "unstyled"
        save_png(style_sheet(self._photographs, columns, title=title), folder / "sheet.png")

    @cached_property
    def _photographs(self) -> list[Image.Image]:
        return thumbnails(_pictures_of(self.encoded.views.images[0], self.encoded.sources))

    @cached_property
    def before(self) -> list[Column]:
        """The column of the reconstruction itself, unless the views are renders of it."""
        if self.encoded.reconstruction["kind"] == "given":
            return []
        with self.stages("render", "the unstyled scene"):
            renders = _pictures_of(self.encoded.render(self.restyler.unstyled), self.encoded.sources)
            return [("unstyled", None, thumbnails(renders))]


def _pictures_of(images: Iterable[Float[Tensor, "3 H W"]], sources: Sequence[SourceImage]) -> list[Image.Image]:
    """Views as pictures, without what lies beside their photographs."""
    pictures = map(to_pil, images)
    return (
        [picture.crop(source.inside) for picture, source in zip(pictures, sources, strict=True)]
        if sources
        else [*pictures]
    )


def _pictures(styles: Sequence[EmbeddedStyle]) -> dict[str, Image.Image]:
    return {style.title: thumbnails([style.cell])[0] for style in styles if isinstance(style.cell, Image.Image)}
