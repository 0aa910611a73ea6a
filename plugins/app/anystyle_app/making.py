"""Making scenes, each in a folder of its own."""

import gc
import logging
import shutil
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import anystyle
from anystyle.errors import UserError
from anystyle.examples import PREFIX, title_of
from anystyle.io.atomic import atomic_path
from anystyle.paths import natural
from anystyle.pipeline.request import inputs_of
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import slug
from anystyle.types import Progress

PAGE = "scene.html"


class Maker:
    """Makes scenes.

    Args:
        out: The folder of all scenes. Each has a folder there, named by its photographs and its style, and an archive.
        overrides: Choices in Hydra's grammar that hold for every scene.
    """

    def __init__(self, out: Path, overrides: Sequence[str] = ()) -> None:
        self.out, self.overrides = out, tuple(overrides)
        self.unwanted: set[str | None] = set()
        """Sessions whose work ends at its next report."""
        self._working = threading.Lock()
        self._closed = False

    @contextmanager
    def working(self) -> Iterator[list[str]]:
        """Work alone; gives the lines of warnings that ``anystyle stylize`` would print, as they come, and prints them.

        :meth:`close` waits for the end: a program that ends while a thread frees tensors is aborted.
        """
        lines: list[str] = []

        class Lines(logging.StreamHandler):
            def emit(self, record: logging.LogRecord) -> None:
                super().emit(record)
                lines.append(record.getMessage())

        handler, root = Lines(), logging.getLogger()
        handler.setLevel(logging.WARNING)
        with self._working:
            root.addHandler(handler)
            try:
                yield lines
            finally:
                root.removeHandler(handler)

    def make(
        self,
        inputs: Sequence[str],
        style: str | Path,
        *,
        strength: float = 1.0,
        method: str = "branch",
        report: Callable[[str, Progress], None] = lambda stage, progress: None,
        session: str | None = None,
    ) -> Path:
        """Stylize a scene into a new folder.

        Args:
            inputs: Photographs, a video or a splat, as files; or an example.
            style: A text; or a picture, as a file or an example.
            strength: In [0, 1]; 0 is the unstyled scene.
            method: How the scene takes the style: a plugin or preset of the kind ``method``.
            report: Called with each stage as it begins, and every few seconds while it goes on.
            session: Who wants the scene; the work ends once it is among the ``unwanted``.

        Raises:
            UserError: As :func:`anystyle.stylize`; or it was stopped.
        """
        if not inputs:
            raise UserError("no photographs are given; add some, or a video or a splat, or choose the example")

        def checked(stage: str, progress: Progress) -> None:
            if self._closed or session in self.unwanted:
                raise UserError("stopped; nothing was kept")
            report(stage, progress)

        files, stages = sorted(inputs, key=lambda path: natural(Path(path).name)), Stages(checked)
        request = anystyle.Request(
            inputs=inputs_of(files),
            styles=(style,),
            controls=(anystyle.Controls(strength=strength),),
            overrides=(f"method={method}", "export.renders=true", *self.overrides, "export.formats=[html]"),
        )
        described = title_of(style) if isinstance(style, Path) else style
        folder = self._new_folder(f"{slug(Path(files[0].removeprefix(PREFIX)).stem)}_{slug(described)}")
        anystyle.stylize(request, out=folder, stages=stages)
        with stages("write", "an archive"), atomic_path(_archive(folder)) as path:
            shutil.make_archive(str(path.with_suffix("")), "zip", self.out, folder.name)
        return folder

    def close(self) -> None:
        """End the work for everybody, and wait until it has ended."""
        self._closed = True
        with self._working:
            gc.collect()

    def made(self) -> list[str]:
        """The names of all scenes, the newest first."""
        pages = sorted(self.out.glob(f"*/{PAGE}"), key=lambda page: page.stat().st_mtime, reverse=True)
        return [page.parent.name for page in pages]

    def _new_folder(self, name: str) -> Path:
        numbered = (self.out / (name if number == 1 else f"{name}-{number}") for number in count(1))
        return next(folder for folder in numbered if not folder.exists() and not _archive(folder).exists())


def files_of(folder: Path) -> dict[str, Path]:
    """The files of a scene that one takes away, by what they are."""
    files = {
        "Page": folder / PAGE,
        "Gaussians": folder / "scene.ply",
        "Video": folder / "video.mp4",
        "All files": _archive(folder),
    }
    return {what: path for what, path in files.items() if path.is_file()}


def _archive(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.zip")
