"""Methods: a file of a few lines says what a method is, how it is run and what it is given."""

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from anystyle.errors import UserError, unknown
from anystyle.io.documents import read_toml
from anystyle.ranges import Positive
from anystyle_benchmark.track import Name

METHODS = Path(__file__).parent / "methods"


class Spec(Struct, frozen=True, forbid_unknown_fields=True):
    """A method: exactly one of ``preset``, ``command``, ``folder`` and ``not_run`` says how its images come to be.

    Args:
        paper: Address of what describes it.
        code: Address of its program, with the commit.
        guides: What it can follow.
        consistent: Whether one 3D scene is rendered; 2D methods paint each view by itself.
        baseline: Whether it is there to test the metrics, and not as a method.
        seeds: How many seeds differ; 1 for what has no randomness.
        preset: Arguments of ``anystyle stylize``, such as ``method=brush``; ``{seed}`` is the seed.
        command: A program with its arguments, in an environment of its own: ``{python}`` is that environment's
            interpreter, ``{here}`` the folder of the spec, ``{job}`` the file that says what is asked.
        requirements: Pinned packages of that environment.
        folder: Images that somebody made, ``SCENE/STYLE/VIEW.png``.
        not_run: Why nobody has run it here yet, and what it needs.
        hours: Time after which a scene's process is stopped.
    """

    name: Name
    title: str
    about: str = ""
    paper: str = ""
    code: str = ""
    licence: str = ""
    guides: Annotated[tuple[Literal["image", "text"], ...], Meta(min_length=1)] = ("image",)
    consistent: bool = True
    baseline: bool = False
    seeds: Annotated[int, Meta(ge=1, le=100)] = 1
    preset: tuple[str, ...] | None = None
    command: Annotated[tuple[str, ...], Meta(min_length=1)] | None = None
    requirements: tuple[str, ...] = ()
    folder: str | None = None
    not_run: str | None = None
    hours: Positive = 12.0


def read_spec(method: str) -> tuple[Spec, Path]:
    """The spec of a bundled method, or that in a file, with its folder."""
    path = Path(method) if method.endswith(".toml") else METHODS / f"{method}.toml"
    if not path.is_file() and path.parent == METHODS:
        raise UserError(unknown("method", method, names()))
    spec: Spec = read_toml(path, Spec, what="spec of a method")
    ways = ("preset", "command", "folder", "not_run")
    if len(given := [name for name in ways if getattr(spec, name) is not None]) != 1:
        raise UserError(f"{path} gives {' and '.join(given) or 'nothing'}; a spec has one of {', '.join(ways)}")
    if any("==" not in line and "@" not in line for line in spec.requirements):
        raise UserError(f"{path}: requirements are pinned, such as numpy==2.1.0")
    if spec.folder is not None and not (path.parent / spec.folder).is_dir():
        raise UserError(f"{path}: there is no folder {path.parent / spec.folder}")
    return spec, path.parent


def names() -> list[str]:
    """The bundled methods."""
    return sorted(path.stem for path in METHODS.glob("*.toml"))
