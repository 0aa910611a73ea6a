"""The form as a command line of ``anystyle stylize``, checked as the command checks it."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import is_override, split
from anystyle.errors import UserError, unknown
from anystyle.examples import PREFIX, examples, resolved
from anystyle.pipeline.controls import Controls
from anystyle.pipeline.request import Request, parser
from anystyle.pipeline.styles import Named, check_text
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import choices
from anystyle_start.library import Kind, Settings

QUALITIES = ("draft", "good", "best")


def command_words(
    settings: Settings, kind: Kind | None, inputs: str, pictures: Path, masks: Path | None = None
) -> list[str]:
    """The arguments of ``anystyle stylize`` without ``--out``; a UserError says which of the settings makes no sense.

    ``inputs`` of a ``kind`` are a folder, a file, or an example; ``pictures`` is the folder of uploaded pictures,
    ``masks`` that of masks of photographs, where there are some.
    """
    for text in settings.texts:
        check_text(text, "the style in words")
    further = _further(settings.more)
    styles = (*settings.texts, *(_picture(image_word(pictures, name)) for name in settings.images))
    controls = Controls(settings.strength, settings.preserve_color, settings.scale)
    mix = [] if settings.mix is None else ["--mix", f"{settings.mix:g}"]
    given = {word.lstrip("+~").partition("=")[0] for word in further if is_override(word)}
    ours = {key: word for key, word in _overrides(settings, kind).items() if key not in given}
    if {"reconstruction", "poses"} & given:  # what is left of ours may not fit to the choice
        ours = {key: word for key, word in ours.items() if key == "method"}
    if masks is not None and "views.masks" not in given:
        further = ["--photo-masks", str(masks), *further]
        ours |= {"views.masked": "views.masked=empty"} if settings.masked == "empty" else {}
    words = [*Request((inputs,), styles).args(), *mix, *Request(controls=(controls,)).args(), *ours.values(), *further]
    Request.from_args(words).check()
    return words


def _overrides(settings: Settings, kind: Kind | None) -> dict[str, str]:
    """The words that choose components, by their keys."""
    for what, value, known in (
        ("method", settings.method, choices("method")),
        ("quality", settings.quality, QUALITIES),
    ):
        if value not in known:
            raise UserError(unknown(what, value, known))
    words = {} if settings.method == "branch" else {"method": f"method={settings.method}"}
    estimator = next(iter(catalog().names("pose_estimator")), None)
    if kind == "splat" or estimator is None:
        return words
    # Named, so that photographs whose cameras are not found are an error, whose reasons the page shows.
    made_by = catalog().find("pose_estimator", estimator).load().reconstruction
    return words | {
        "poses": f"poses={estimator}",
        "reconstruction": f"reconstruction={made_by}",
        "reconstruction.quality": f"reconstruction.quality={settings.quality}",
    }


def image_word(pictures: Path, name: str) -> str:
    """An example, or the file of an uploaded picture, as an argument."""
    if name.startswith(PREFIX):
        resolved(Path(name))  # refuses what is not an example
        return name
    path = next((path for path in pictures.glob("*.png") if path.name == name), None)
    if path is None:
        raise UserError(f"there is no picture {name[:80]!r} any more; add it again")
    return str(path)


def _picture(word: str) -> Path | Named:
    """An uploaded picture under the name that it had, without the hash that is stored behind it."""
    file = Path(word)
    return file if word.startswith(PREFIX) else Named(file, file.stem.rpartition("-")[0] or file.stem)


def _further(text: str) -> list[str]:
    """The arguments in the field for all options; none that would change where inputs and results lie."""
    try:
        words = shlex.split(text)
    except ValueError:
        raise UserError("further options: a quotation mark is not closed; close it, or leave it out") from None
    arguments, overrides = split(parser(), words)
    for flag, default in (("out", parser().get_default("out")), ("open", False)):
        if getattr(arguments, flag) != default:
            raise UserError(f"further options: --{flag} has no place here; the page keeps the results")
    if arguments.inputs:
        what = f"{arguments.inputs[0]!r} is not an option; write KEY=VALUE or a flag such as --mask WHERE"
        raise UserError(f"further options: {what}")
    if foreign := [word for word in overrides if not is_override(word) or word.lstrip("+~").startswith("hydra")]:
        raise UserError(f"further options: {foreign[0]} is for the command line only")
    return words


def shown_command(words: Sequence[str], title: str) -> str:
    """The command line that reproduces a run, to be copied into a shell."""
    name = "-".join("".join(c if c.isalnum() else " " for c in title).split())
    return shlex.join(["anystyle", "stylize", *words, "--out", f"styled-{name or 'scene'}"])


def painting_names() -> list[str]:
    """The examples that are pictures."""
    return [name for name, example in examples().items() if Path(example.file).suffix]
