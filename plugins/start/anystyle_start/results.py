"""What a run has made, as the page shows it, and as files to download."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from anystyle.data import images
from anystyle.errors import UserError
from anystyle.examples import examples
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import read_json
from anystyle.pipeline.saved import OWN, UNSTYLED
from anystyle.registry.catalog import catalog
from anystyle_start.library import ERROR
from anystyle_start.uploads import SIDE

ALL = "all"
"""Instead of the number of a style."""
ARCHIVE = "zip"


@dataclass(frozen=True)
class ReconstructionFacts:
    """What ``report.json`` says of how the scene was made."""

    registered: int = 0
    heldout_psnr: float | None = None
    heldout_ssim: float | None = None
    trust: str = ""
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """What is read of ``report.json``."""

    style: str | list[str] = ""
    controls: str = ""
    gaussians: int = 0
    views: int = 0
    inputs: list[str] = field(default_factory=list)
    reconstruction: ReconstructionFacts = field(default_factory=ReconstructionFacts)
    licenses: dict[str, dict[str, str]] = field(default_factory=dict)


class StyleFolder(NamedTuple):
    """The scene in one style."""

    title: str
    folder: Path


def read_report(run: Path) -> Report:
    """The report of a run."""
    return read_json(run / "report.json", Report, what="report")


def styles_of(run: Path, report: Report) -> list[StyleFolder]:
    """The styles of a run, in their order."""
    folders = [run] if isinstance(report.style, str) else sorted(file.parent for file in run.glob("*/report.json"))
    reports = [read_report(folder) for folder in folders]
    return [
        StyleFolder(", ".join(filter(None, [str(one.style).strip("“”"), one.controls])), folder)
        for one, folder in zip(reports, folders, strict=True)
    ]


def shown_title(style: StyleFolder) -> str:
    """The display title of a style: that of an example, or the name of an uploaded picture without its hash."""
    name, comma, controls = style.title.partition(", ")
    known = examples()
    return f"{known[name].title if name in known else re.sub(r'-[0-9a-f]{8}$', '', name)}{comma}{controls}"


def page_of(run: Path) -> Path | None:
    """The page that shows a run's styles; where styles have Gaussians of their own, that of the first."""
    return next(iter([*run.glob("scene.html"), *sorted(run.glob("*/scene.html"))]), None)


def picture(style: StyleFolder, files: Path) -> Path | None:
    """A small picture of the scene in a style: the middle one of its renders."""
    renders = sorted((style.folder / "renders").glob("*.png"))
    if not renders:
        return None
    target = files / f"{style.folder.name}.jpg"
    if not target.is_file():
        small = images.open_image(renders[len(renders) // 2], longest=2 * SIDE)
        small.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
        with atomic_path(target) as path:
            small.save(path, "JPEG", quality=85)
    return target


def formats() -> dict[str, bool]:
    """The formats of downloads, and whether a file holds several styles."""
    known = {name: catalog().find("format", name).load() for name in catalog().names("format")}
    return {name: kind.many_styles for name, kind in known.items() if not kind.index} | {ARCHIVE: True}


def download(run: Path, files: Path, name: str, style: str, program: Sequence[str]) -> Path:
    """The file of a scene in a format; made by ``anystyle export`` the first time it is asked for.

    Args:
        run: The results.
        files: Where more files of them are stored.
        name: A plugin of kind ``format``, or ``zip`` for all results.
        style: The number of a style, ``unstyled``, or ``all`` for formats that hold several.
        program: The words that start ``anystyle``.
    """
    known, styles = formats(), styles_of(run, read_report(run))
    if name not in known:
        raise UserError(f"no format is named {name[:40]!r}; there are {', '.join(known)}")
    unstyled = run / f"{UNSTYLED}{OWN}"
    if style == UNSTYLED and (name == ARCHIVE or not unstyled.is_file()):
        raise UserError("the unstyled scene is one file of an archive of all styles; choose these, or another format")
    if style not in (ALL, UNSTYLED) and not (style.isdecimal() and int(style) < len(styles)):
        raise UserError("this style is not there any more; load the page again")
    if style == ALL and not known[name] and len(styles) > 1:
        raise UserError(f"a {name} file holds one style; choose one")
    source = run if style == ALL else unstyled if style == UNSTYLED else styles[int(style)].folder
    if name in ("html", "ply") and (source / f"scene.{name}").is_file():
        return source / f"scene.{name}"
    target = files / f"{style}.{name}"
    if target.is_file():
        return target
    files.mkdir(exist_ok=True)
    if name == ARCHIVE:
        with atomic_path(target) as path:
            shutil.make_archive(str(path.with_suffix("")), "zip", source)
        return target
    command = [*program, "export", str(source), "--to", name, "--out", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", stdin=subprocess.DEVNULL)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith(ERROR)]
        raise UserError(lines[-1].removeprefix(ERROR) if lines else f"{name} could not be written")
    return target


def left_out(names: Sequence[str], report: Report) -> list[str]:
    """The files of photographs that got no camera."""
    known = {re.sub(r"\W+", "-", name).casefold() for name in report.inputs}
    return [name for name in names if re.sub(r"\W+", "-", Path(name).stem).casefold() not in known]
