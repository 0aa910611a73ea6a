"""The flags of ``anystyle stylize``, read before torch is imported, so that a mistyped word is answered at once."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from anystyle.cli.arguments import new_parser, split
from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.registry.compose import override


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle stylize``; every other argument is a Hydra override."""
    flags = new_parser(
        "stylize",
        "Stylize photographs as a 3D Gaussian scene. Arguments such as key=value are Hydra overrides.",
        epilog="Every option of every component: anystyle stylize --cfg job",
    )
    add = flags.add_argument
    inputs = "a folder, files, a glob or a video; a PLY file or a folder of results; or none with scenes=NAME"
    add("inputs", nargs="*", help=inputs)
    style: dict[str, Any] = {"action": _StyleFlag, "dest": "styles", "default": []}
    add("--text", **style, help="a style in words; may be given several times")
    add("--image", **style, help="a style as an image file; likewise")
    name = "what the --text or --image before it is called in folders, on the sheet and in pages"
    add("--name", action=_NameFlag, dest="styles", help=name)
    mix = "with exactly two styles: the point between them, 0 is the first and 1 the second; likewise"
    add("--mix", action="append", default=[], metavar="AMOUNT", help=mix)
    control = flags.add_argument_group("how a style is applied; several values make a strip").add_argument
    several: dict[str, Any] = {"action": "append", "default": []}
    control("--strength", **several, metavar="0..1", help="0 is the unstyled scene")
    control("--preserve-color", **several, metavar="0..1", help="keep the scene's hues")
    control("--scale", **several, metavar="FACTOR", help="size of strokes")
    mask = "where style enters: a folder of masks, sphere:X,Y,Z,RADIUS or box:X,Y,Z,X,Y,Z; ,soft=WIDTH after it"
    control("--mask", **several, metavar="WHERE", help=mask)
    photo_masks = (
        "images named as the photographs; what is black in them, such as people or the sky, is not learnt. "
        "views.masked=empty: nothing is there"
    )
    add("--photo-masks", metavar="DIR", help=photo_masks)
    add("--run", metavar="DIR", help="in place of model=NAME: the style branch that a training wrote, with its parts")
    formats = "additional files of the scene, by the names of `anystyle plugins format`; several with commas"
    add("--export", default="", metavar="FORMATS", help=formats)
    add("--again", metavar="REPORT", help="what a report.json was asked for; further arguments are added")
    add("--out", default="out", help="where the results go (default: %(default)s)")
    add("--overwrite", action="store_true", help="replace the results of another run in --out")
    add("--open", action="store_true", help="look at them in the browser, where there is a display")
    return flags


def parsed(args: Sequence[str], flags: argparse.ArgumentParser | None = None) -> tuple[argparse.Namespace, list[str]]:
    """The flags of a command line, and its overrides with those that flags stand for."""
    arguments, overrides = split(flags or parser(), args)
    if arguments.again is not None:
        request = read_json(Path(arguments.again), dict[str, Any], what="report").get("request")
        if not isinstance(request, list):
            raise UserError(f"{arguments.again} does not say what was asked for; its inputs were in memory or left out")
        index = next(i for i, word in enumerate(args) if word.partition("=")[0] == "--again")
        following = args[index + (1 if "=" in args[index] else 2) :]
        return parsed([*map(str, request), *args[:index], *following], flags)
    meant: dict[str, object] = {} if arguments.photo_masks is None else {"views.masks": arguments.photo_masks}
    if arguments.run is not None:
        meant["run"] = arguments.run
    if arguments.export:
        if any(word.startswith("export.formats=") for word in overrides):
            raise UserError("formats are named twice; give --export or export.formats")
        meant["export.formats"] = arguments.export.split(",")
    return arguments, [*(override(key, value) for key, value in meant.items()), *overrides]


class _StyleFlag(argparse.Action):
    """Collects texts and images in one list, so that styles have the order in which they are typed."""

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, option_string: Any = None) -> None:
        namespace.styles = [*namespace.styles, (Path if option_string == "--image" else str, values, None)]


class _NameFlag(argparse.Action):
    """Names the style before it."""

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, option_string: Any = None) -> None:
        if not namespace.styles or namespace.styles[-1][2] is not None:
            raise UserError(f"--name {values} follows the --text or --image that it names")
        *others, (kind, word, _) = namespace.styles
        namespace.styles = [*others, (kind, word, values)]
