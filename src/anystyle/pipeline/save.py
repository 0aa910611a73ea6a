"""The last step: the files of results."""

import logging
import shutil
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from threading import Event

import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError, one_line
from anystyle.formats import comments
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.transforms import Similarity
from anystyle.io import ply
from anystyle.io.atomic import atomic_directory, final, write_json
from anystyle.io.checkpoint import save_tensors
from anystyle.io.sheet import Cell, save_png, shown, style_sheet, thumbnails, to_pil
from anystyle.io.splats import NEAR, Offset
from anystyle.paths import names_below
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.film import Film
from anystyle.pipeline.options import VideoOptions
from anystyle.pipeline.request import PICTURE, SavedScene
from anystyle.pipeline.results import Result, Results, StylizeRun, pictures
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, SourceImage, StyledScene

_log = logging.getLogger(__name__)
CONVENTION = "OpenCV axes (x right, y down, z forward); intrinsics in source pixels; lengths in the scene's own unit"
MAX_POINTS = 100_000
"""Points of a COLMAP export: what an optimisation of Gaussians starts from."""
Column = tuple[str, Cell, Sequence[Cell]]
"""Of a sheet: title, style image if there is one, renders as small as its cells."""


def save(results: Results | Result, folder: str | Path) -> None:
    """Write results and what they have in common, or one; files of the same names are replaced, all or none.

    A single result lies in the folder itself, several in folders of their own beside a sheet of all.

    Raises:
        UserError: A format cannot hold the scene; all other files are in the folder.
    """
    with atomic_directory(folder) as temporary:
        if isinstance(results, Results):
            failures = write(results, temporary)
        else:
            writer = _ResultWriter(results.run, temporary)
            with results.run.stages("write", writer.line):
                writer.write(results, temporary)
            failures = writer.failures
    failures.tell(Path(folder))


class Failures:
    """What formats could not write, while all other files were: a result is whole without it."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.bug: Exception | None = None
        """The first error that no format should raise."""
        self.ending: BaseException | None = None
        """What interrupted the run, after some styles were finished."""

    def add(self, file: str, error: Exception) -> None:
        """Note that a file could not be written."""
        # As text: a traceback would keep the Gaussians of every style in memory.
        self.lines.append(f"{file}: {one_line(error)}")
        if self.bug is None and not isinstance(error, (UserError, ImportError)):
            self.bug = error

    def tell(self, folder: Path) -> None:
        """Raise what could not be written into a folder, if anything: a UserError, or the bug of a format.

        Or the interruption after which only some styles are there.
        """
        if self.ending is not None:
            raise self.ending
        if not self.lines:
            return
        told = f"{'; '.join(self.lines)}; not written, and all else is in {folder}"
        if self.bug is None:
            raise UserError(told)
        self.bug.add_note(told)
        raise self.bug


def write(results: Results, folder: Path) -> Failures:
    """Write all results into a folder that has none of their files, and return what formats could not write."""
    run, several = results.run, len(results) > 1
    writer = _ResultWriter(run, folder, several=several)
    written: list[Future[Column]] = []
    columns, styles, report = [*writer.before], [("unstyled", run.unstyled)], {}

    def wait() -> None:
        with run.stages("write", writer.line):
            written[-1].result()

    # A result is rendered and encoded in a thread while the next one is computed: memory holds two, and no film.
    with ThreadPoolExecutor(1) as thread:
        try:
            for number, result in enumerate(results, start=1):
                if written:
                    wait()
                inside = folder / f"{number:02d}-{result.style.name}" if several else folder
                written.append(thread.submit(writer.write, result, inside))
                report = result.report
                if any(result.shares(kind.shared) for kind in writer.common_formats.values()):
                    styles.append((result.style.title, result.gaussians))
            wait()
        except BaseException as error:
            writer.stop.set()
            if not isinstance(error, KeyboardInterrupt | SystemExit):
                raise
            writer.failures.ending = error
    columns += [future.result() for future in written if future.exception() is None]
    made = results.styles[: len(columns) - len(writer.before)]
    if ending := writer.failures.ending:
        if not (several and made):
            raise ending
        for unfinished in folder.glob(f"{len(made) + 1:02d}-*"):
            shutil.rmtree(unfinished)
        line = "%d of %d styles are in %s; the same command makes all, and `anystyle stylize %s` others of its scene"
        _log.warning(line, len(made), len(results), final(folder), final(folder))
    with run.stages("write", "what the styles have in common"):
        save_gaussians(run.unstyled, folder / "unstyled.safetensors")
        if several:
            writer.write_sheet(folder, columns)
        for name, kind in writer.common_formats.items():
            alike = [(title, gaussians) for title, gaussians in styles if gaussians.shares(run.unstyled, kind.shared)]
            if len(alike) > 1:
                writer.export(run.scene(alike, results.styles), folder / f"scene.{name}", name)
    if several:
        common = {"style": [style.title for style in made], "provenance": run.made_of(made)}
        write_json(folder / "report.json", report | run.stages.report() | common)
    return writer.failures


class _ResultWriter:
    """Writes results below a folder; set ``stop`` to end a film that is being written in a thread."""

    def __init__(self, run: StylizeRun, folder: Path, *, several: bool = False) -> None:
        self.run, self.encoded, self.folder = run, run.encoded, folder
        self.options, self.film = run.request.export, Film(run.request.video)
        self.filmed = run.encoded.targets or (run.encoded.names, run.encoded.cameras)
        # A file of Gaussians is looked at where it comes from; pictures of it would take half of the time.
        inputs, film = run.request.inputs, f"renders and a film {self.film.line(self.filmed[1])}"
        given = isinstance(inputs, SavedScene) and inputs.path.is_file() and run.request.video == VideoOptions()
        self.pictured = not given if self.options.renders is None else self.options.renders
        self.line = f"scene, {film}" if self.pictured else f"scene and sheet; export.renders=true adds {film}"
        self.failures, self.stop = Failures(), Event()
        names = [name for name in self.options.formats if name != "ply"]
        self.formats: dict[str, type[Format]] = {name: catalog().find("format", name).load() for name in names}
        # Of a format whose files hold several styles, one lies beside the sheet, with all that share what it asks.
        self.common_formats = {name: kind for name, kind in self.formats.items() if kind.many_styles and several}

    def write(self, result: Result, folder: Path) -> Column:
        """Write a result into a folder of its own, and return the column of a sheet over several styles."""
        folder.mkdir(parents=True, exist_ok=True)
        self._write_scenes(result, folder)
        cameras, sources = result.cameras, self.encoded.sources
        if self.pictured:
            renders = self._write_renders(result, folder / "renders", self.encoded.names, cameras, sources)
            self._write_film(result, folder)
        else:
            rows = shown(len(sources))
            renders = _pictures_of(result.render(cameras.select(rows)), [sources[row] for row in rows])
        self._write_cameras(result, folder)
        column = (result.style.title, result.style.cell, thumbnails(renders))
        for picture in pictures([result.style]).values():
            picture.save(folder / PICTURE, quality=90)
        self.write_sheet(folder, [*self.before, column])
        write_json(folder / "report.json", result.report)
        return column

    def _write_scenes(self, result: Result, folder: Path) -> None:
        scene, given, as_given = result.scene(), self.encoded.splat, ("means", "rotations", "scales", "opacities")
        # A trip through float32 logarithms and back moves the last bits.
        kept = self.options.up in (None, "opencv") and result.shares(as_given)
        source = given if kept and given is not None and given.suffix.lower() == ".ply" else None
        colors, notes = result.gaussians.harmonics[0], comments(scene)
        if source is None or not ply.recolor(source, colors, folder / "scene.ply", notes):
            export_styles(scene, folder / "scene.ply", "ply", up=self.options.up)
        for name, kind in self.formats.items():
            if not (name in self.common_formats and result.shares(kind.shared)):
                self.export(result.scene(kind.shared), folder / f"scene.{name}", name)
        save_gaussians(result.gaussians, folder / "scene.safetensors")

    def export(self, scene: StyledScene, path: Path, name: str) -> None:
        """Write a scene as a file of a format, or note that the format cannot."""
        try:
            export_styles(scene, path, name, up=self.options.up)
        except OSError:  # no room is left, for other files neither
            raise
        except Exception as error:  # a bug of a plugin is raised in the end: hours of work may lie behind the results
            self.failures.add(str(path.relative_to(self.folder)), error)

    def _write_film(self, result: Result, folder: Path) -> None:
        encoded, (names, cameras) = self.encoded, self.filmed
        if encoded.targets is not None:
            self._write_renders(result, folder / "targets", names, cameras)
        seen = encoded.photographed and encoded.targets is None
        scene = StyledScene(((result.style.title, result.gaussians),), cameras, tuple(names), photographed=seen)
        self.film.write(scene, folder / "video.mp4", encoded.stylizer.render, self.stop)

    def _write_cameras(self, result: Result, folder: Path) -> None:
        encoded, cameras = self.encoded, result.cameras.to("cpu")
        write_cameras(folder / "cameras.json", cameras, encoded.sources, encoded.offset, encoded.scene_from_known)
        if self.options.colmap != "none":
            model, binary = folder / "sparse" / "0", self.options.colmap == "binary"
            write_colmap(model, result.gaussians, cameras, encoded.sources, binary=binary)

    def _write_renders(
        self, result: Result, folder: Path, names: Sequence[str], cameras: Cameras, sources: Sequence[SourceImage] = ()
    ) -> list[Image.Image]:
        folder.mkdir()
        renders = _pictures_of(result.render(cameras), sources)
        for name, image in zip(names, renders, strict=True):
            save_png(image, folder / f"{name}.png")
        return renders

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
        with self.run.stages("render", "the unstyled scene"):
            renders = _pictures_of(self.encoded.render(self.run.unstyled), self.encoded.sources)
            return [("unstyled", None, thumbnails(renders))]


def _pictures_of(images: Iterable[Float[Tensor, "3 H W"]], sources: Sequence[SourceImage]) -> list[Image.Image]:
    """Views as pictures, without what lies beside their photographs."""
    pictures = map(to_pil, images)
    if not sources:
        return list(pictures)
    return [picture.crop(source.inside) for picture, source in zip(pictures, sources, strict=True)]


def save_gaussians(gaussians: Gaussians, path: Path) -> None:
    """Write every tensor of some Gaussians, without the loss of the PLY's conventions, as safetensors."""
    tensors = {item.name: getattr(gaussians, item.name).detach().cpu().contiguous() for item in fields(gaussians)}
    mode = {"antialiased": "true"} if gaussians.antialiased else {}
    save_tensors(path, tensors, {"format": "anystyle/1 gaussians"} | mode)


def write_cameras(
    path: Path,
    cameras: Cameras,
    sources: Sequence[SourceImage],
    offset: Offset = NEAR,
    scene_from_known: Similarity | None = None,
) -> None:
    """Write the cameras of views as readable JSON, with intrinsics in pixels of their sources.

    Where known cameras were given, the similarity from their frame to the scene's is written as well.
    """
    matrices = zip(_source_intrinsics(cameras, sources), cameras.world_from_camera[0], strict=True)
    views = [
        {"name": source.name, "height": source.size[0], "width": source.size[1]}
        | {"intrinsics": intrinsics.tolist(), "world_from_camera": pose.tolist()}
        for source, (intrinsics, pose) in zip(sources, matrices, strict=True)
    ]
    content: dict[str, object] = {"convention": CONVENTION, "views": views}
    if any(offset):
        content["offset"] = {"meaning": "to add to all positions", "xyz": offset}
    if scene_from_known is not None:
        content["scene_from_known"] = {
            "meaning": "scene = scale * rotation @ known + translation",
            **{name: value.tolist() for name, value in scene_from_known._asdict().items()},
        }
    write_json(path, content)


def write_colmap(
    folder: Path, gaussians: Gaussians, cameras: Cameras, sources: Sequence[SourceImage], *, binary: bool
) -> None:
    """Write one scene as a COLMAP model: cameras in source pixels, images, and the most opaque Gaussians as points."""
    from anystyle.io import colmap

    opacities, cameras = gaussians.opacities[0].cpu(), cameras.to(torch.float64)
    most_opaque = opacities.argsort(descending=True, stable=True)[: min(MAX_POINTS, int((opacities > 0).sum()))]
    rgb = rgb_from_constant(gaussians.harmonics[0, :, 0].cpu()[most_opaque])
    paths = [source.path for source in sources if source.path is not None]
    files = dict(zip(paths, names_below(paths), strict=True))
    model = colmap.pinhole_model(
        [f"{source.name}.png" if source.path is None else files[source.path] for source in sources],
        [source.size for source in sources],
        _source_intrinsics(cameras, sources).numpy(),
        cameras.camera_from_world[0].numpy(),
        gaussians.means[0].cpu()[most_opaque].double().numpy(),
        (rgb.clamp(0, 1) * 255).round().byte().numpy(),
    )
    colmap.write(model, folder, binary=binary)


def _source_intrinsics(cameras: Cameras, sources: Sequence[SourceImage]) -> Float[Tensor, "V 3 3"]:
    pairs = zip(sources, cameras.intrinsics[0], strict=True)
    return torch.stack([source.source_intrinsics(matrix) for source, matrix in pairs])
