"""A scene as a file that other programs read, or as one page for a browser."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.run import run, words_of
from anystyle.errors import UserError


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
    return words


def export(arguments: argparse.Namespace, overrides: Sequence[str] = ()) -> None:
    """Run the command; overrides are of the options ``splat``."""
    from anystyle.pipeline.export import export_styles
    from anystyle.pipeline.options import SplatOptions, named_axes
    from anystyle.pipeline.saved import read_saved
    from anystyle.registry.catalog import catalog
    from anystyle.registry.compose import only_options

    name = arguments.to or arguments.out.suffix.lstrip(".").lower()
    formats = catalog().names("format")
    if name not in formats:
        raise UserError(f"no format is named; give --to with one of {', '.join(formats)}")
    if arguments.out.exists() and arguments.scene.exists() and arguments.out.samefile(arguments.scene):
        raise UserError(f"{arguments.out} is the scene itself; name another file with --out")
    if (arguments.scene / "report.json").is_file() and (arguments.from_up or overrides):
        raise UserError(
            "a folder of results is in OpenCV's axes; --from-up and splat.KEY=VALUE are for files of others"
        )
    splat = only_options("splat", overrides) if overrides else SplatOptions()
    saved = read_saved(arguments.scene, replace(splat, up=arguments.from_up or splat.up))
    saved = replace(saved, title=arguments.scene.resolve().stem)
    size = export_styles(saved, arguments.out, name, up=named_axes("--up", arguments.up))
    print(f"{arguments.out}: {size / 1e6:.2f} MB, {saved.styles[-1][0]}")


if __name__ == "__main__":
    run(lambda: export(*split(parser(), words_of(None))))
