"""A scene as a file that other programs read, or as one page for a browser."""

import argparse
from dataclasses import replace
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import run, words_of
from anystyle.errors import UserError


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle export``."""
    words = new_parser("export", "Write a scene in another format.")
    add, axes = words.add_argument, ("opencv", "y", "z")
    add("scene", type=Path, help="a file of Gaussians, or a folder of anystyle stylize")
    add("--to", help="the format, one of `anystyle plugins format` (default: the suffix of --out)")
    add("--out", type=Path, required=True, help="the file to write")
    add("--up", choices=axes, help="axes of the file (default: what readers of the format expect)")
    add("--from-up", choices=axes, help="axes of another program's file (default: what it says, or else its format)")
    add("--no-provenance", action="store_true", help="leave out what the scene was made of, names and texts")
    return words


def export(arguments: argparse.Namespace) -> None:
    """Run the command."""
    from anystyle.pipeline.export import export_styles
    from anystyle.pipeline.provenance import anonymous
    from anystyle.pipeline.saved import read_saved, with_stored_cameras
    from anystyle.registry.catalog import catalog

    name = arguments.to or arguments.out.suffix.lstrip(".").lower()
    formats = catalog().names("format")
    if name not in formats:
        raise UserError(f"no format is named; give --to with one of {', '.join(formats)}")
    if arguments.out.exists() and arguments.scene.exists() and arguments.out.samefile(arguments.scene):
        raise UserError(f"{arguments.out} is the scene itself; name another file with --out")
    if arguments.scene.is_dir() and arguments.from_up is not None:
        raise UserError("a folder of results is in OpenCV's axes; --from-up is for files of others")
    saved = read_saved(arguments.scene, arguments.from_up)
    if catalog().find("format", name).load().needs_cameras:
        saved = with_stored_cameras(saved, arguments.scene)
    saved = replace(saved, title=arguments.scene.resolve().stem)
    saved = anonymous(saved) if arguments.no_provenance else saved
    export_styles(saved, arguments.out, name, up=arguments.up)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB, {saved.styles[-1][0]}")


if __name__ == "__main__":
    run(lambda: export(parse(parser(), words_of(None))))
