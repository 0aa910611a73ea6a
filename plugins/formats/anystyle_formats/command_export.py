"""``anystyle export``: a scene in another format, of fewer Gaussians where that is asked for."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.cli.arguments import new_parser, split
from anystyle.contracts import Command, Renderer
from anystyle.errors import UserError


class Export(Command):
    """A scene as a file that other programs read, or as one page for a browser."""

    def __call__(self, words: Sequence[str]) -> None:
        export(*split(parser(), list(words)))


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle export``."""
    more = "splat.activated=true reads a file with scales as lengths and opacities in 0 to 1."
    words = new_parser("export", "Write a scene in another format.", more)
    add, axes = words.add_argument, ("opencv", "x", "-x", "y", "-y", "z", "-z")
    add("scene", type=Path, help="a file of Gaussians, or a folder of anystyle stylize")
    add("--to", help="the format, one of `anystyle plugins format` (default: the suffix of --out)")
    add("--out", type=Path, required=True, help="the file to write")
    add("--up", choices=axes, help="what is up in the file (default: what readers of the format expect)")
    add("--from-up", choices=axes, help="what is up in another program's (default: what it says, or else its format)")
    add("--max-gaussians", type=int, metavar="N", help="merge it into at most so many, where that shows least")
    return words


def export(arguments: argparse.Namespace, overrides: Sequence[str] = ()) -> None:
    """Run the command; overrides are of the options ``splat``."""
    from anystyle.pipeline.export import export_styles, in_axes
    from anystyle.pipeline.options import SplatOptions, ViewOptions, named_axes
    from anystyle.pipeline.request import file_of
    from anystyle.pipeline.saved import PAINTED, cameras_of, read_unturned, tidied
    from anystyle.registry.build import build
    from anystyle.registry.catalog import catalog
    from anystyle.registry.compose import only_options

    name = arguments.to or arguments.out.suffix.lstrip(".").lower()
    formats = catalog().names("format")
    if name not in formats:
        raise UserError(f"no format is named; give --to with one of {', '.join(formats)}")
    result = arguments.out.name == "scene.ply" and (arguments.out.parent / "report.json").is_file()
    if arguments.out.exists() and (result or (arguments.scene.exists() and arguments.out.samefile(arguments.scene))):
        raise UserError(f"{arguments.out} is the scene itself, or part of a result; name another file with --out")
    if (arguments.scene / "report.json").is_file() and (arguments.from_up or overrides):
        raise UserError("a folder of results is in OpenCV's axes; --from-up and splat.KEY=VALUE are for other files")
    splat = only_options("splat", overrides) if overrides else SplatOptions()
    splat = replace(
        splat,
        up=arguments.from_up or splat.up,
        max_gaussians=splat.max_gaussians if arguments.max_gaussians is None else arguments.max_gaussians,
    )
    given = read_unturned(arguments.scene, splat)
    saved = replace(in_axes("opencv", given), title=arguments.scene.resolve().stem)
    if splat.max_gaussians is not None:
        renderer, path = build(Renderer, "auto"), file_of(arguments.scene)
        cameras, *_ = cameras_of(path, saved, ViewOptions(), splat, renderer, 1, PAINTED, given.up)
        styles = tuple((title, tidied(each, cameras, renderer, splat)) for title, each in saved.styles)
        saved = replace(saved, styles=styles)
    size = export_styles(saved, arguments.out, name, up=named_axes("--up", arguments.up))
    print(f"{arguments.out}: {size / 1e6:.2f} MB, {saved.styles[-1][0]}")
