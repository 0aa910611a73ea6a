"""A scene as a file that other programs read: GLB, SPZ, SOG, .splat, PLY or one HTML page."""

import argparse
from pathlib import Path

from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.errors import UserError

FORMATS = ("glb", "spz", "sog", "splat", "ply", "html")


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle export``."""
    words = new_parser("export", "Write a scene in another format.")
    words.add_argument(
        "scene", type=Path, help="a PLY file of any degree, compressed or not, or a folder of anystyle stylize"
    )
    words.add_argument("--to", choices=FORMATS, help="the format (default: the suffix of --out)")
    words.add_argument("--out", type=Path, required=True, help="the file to write")
    words.add_argument(
        "--up", choices=("opencv", "y", "z"), help="axes of the file (default: what readers of the format expect)"
    )
    words.add_argument(
        "--from-up",
        choices=("opencv", "y", "z"),
        default="opencv",
        help="axes that a PLY file of others is in (default: those of 3DGS)",
    )
    return words


def export(arguments: argparse.Namespace) -> None:
    """Run the command."""
    from anystyle.inference import export as files
    from anystyle.inference.export import write_page
    from anystyle.inference.saved import read_saved

    name = arguments.to or arguments.out.suffix.lstrip(".").lower()
    if name not in FORMATS:
        raise UserError(f"no format is named; give --to with one of {', '.join(FORMATS)}")
    if arguments.out.exists() and arguments.scene.exists() and arguments.out.samefile(arguments.scene):
        raise UserError(f"{arguments.out} is the scene itself; name another file with --out")
    if arguments.scene.is_dir() and arguments.from_up != "opencv":
        raise UserError("a folder of results is in OpenCV's axes; --from-up is for PLY files of others")
    saved = read_saved(arguments.scene, arguments.from_up)
    title, gaussians = saved.styles[-1]
    notes = "\n".join(saved.notes)
    if name == "html":
        write_page(arguments.out, saved.styles, saved.cameras, title=arguments.scene.resolve().stem, notes=notes)
    else:
        files.export(gaussians, arguments.out, name, up=arguments.up, notes=notes)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1e6:.2f} MB, {title}")


if __name__ == "__main__":
    run(lambda: export(parse(parser(), words_of(None))))
