"""``anystyle view``: a scene in the browser, or as one HTML file."""

import argparse
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.cli.arguments import new_parser, split
from anystyle.contracts import Command
from anystyle.errors import UserError, of_extra
from anystyle.pipeline.encode import encode
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.load import load_model
from anystyle.pipeline.read import read
from anystyle.pipeline.request import Request, SavedScene, inputs_of
from anystyle.pipeline.results import Restyler
from anystyle.pipeline.saved import UNSTYLED, read_saved
from anystyle.pipeline.stages import Stages
from anystyle.registry.compose import only_options
from anystyle.vision.weights import license_lines, licenses
from anystyle_viewer.session import CACHE_SIZE, Session

_log = logging.getLogger(__name__)


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle view``; all other words are Hydra's, as those of ``anystyle stylize``."""
    about = "Look at a scene, and give it styles: photographs, a folder of anystyle stylize, or a file of Gaussians."
    flags = new_parser("view", about)
    add = flags.add_argument
    add("input", type=Path, nargs="?", help="a folder of photographs or of results, a video, or a file of Gaussians")
    add("--html", type=Path, metavar="FILE", help="write one page with all saved styles, and end")
    add("--port", type=int, default=8080, help="0 takes a free one (default: %(default)s)")
    kept = "stores styles and uploaded images (default: %(default)s)"
    add("--keep", type=Path, default=Path("out/view"), help=kept)
    return flags


def open_session(path: Path, words: Sequence[str], folder: Path | None = None) -> Session:
    """Encode photographs, or a saved scene by its renders, ready for styles."""
    request = Request(inputs_of(path), overrides=tuple(words))
    request.check_inputs()
    stages = Stages(lambda stage, progress: print(f"{stage} {progress.line} …", file=sys.stderr, flush=True))
    with stages("load", "the model"):
        model = load_model(request)
    encoded = encode(read(request, model, stages), model.stylizer, request.views, stages)
    styles, pictures, notes = {}, {}, [*license_lines(licenses(model.weights)), *encoded.notes]
    if isinstance(request.inputs, SavedScene) and path.is_dir():
        saved = read_saved(path)
        styles = {title: scene for title, scene in saved.styles if title != UNSTYLED}
        notes, pictures = list(dict.fromkeys((*saved.notes, *notes))), saved.pictures
    restyler = Restyler(encoded, model.method, keep=CACHE_SIZE)
    if restyler.unstyled.antialiased:
        _log.warning("%s was trained with antialiasing, which films here are drawn with, and the window is not", path)
    return Session(restyler, saved=styles, folder=folder, notes=notes, pictures=pictures)


class View(Command):
    """A scene in the browser, restyled while one looks; or as one HTML file."""

    def __call__(self, words: Sequence[str]) -> None:
        arguments, overrides = split(parser(), words)
        if arguments.input is None:
            raise UserError("name a scene, as in anystyle view out/; to make one in the browser, anystyle app")
        if arguments.html is not None:
            _write_page(arguments, overrides)
        else:
            _serve_scene(arguments, overrides)


def _write_page(arguments: argparse.Namespace, overrides: Sequence[str]) -> None:
    saved = read_saved(arguments.input, only_options("splat", overrides))
    saved = replace(saved, title=arguments.input.resolve().stem)
    size = export_styles(saved, arguments.html, "html")
    print(f"{arguments.html}: {len(saved.styles)} styles, {size / 1e6:.2f} MB; open it in any browser")


def _serve_scene(arguments: argparse.Namespace, overrides: Sequence[str]) -> None:
    of_extra("viser", "anystyle view needs", "viewer")
    from anystyle_viewer.viewer import Viewer

    opened, folder = (str(arguments.input), overrides), arguments.keep
    with Viewer(open_session(arguments.input, overrides, folder), folder, opened, arguments.port) as viewer:
        print(f"{viewer.server.url} shows {arguments.input}; Ctrl-C ends it", flush=True)
        while True:
            time.sleep(3600)
