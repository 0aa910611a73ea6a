"""Look at training data before it is trained on, and describe paintings."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from anystyle.commands._flags import new_parser, parse, subcommand
from anystyle.commands._run import run, words_of
from anystyle.data.captioning import DEFAULT_MODEL, PROMPT, caption_folder, transformers_captioner
from anystyle.data.checking import Report, check, same_pictures
from anystyle.data.images import SUFFIXES
from anystyle.errors import UserError
from anystyle.evaluation.layout import Layout, is_layout
from anystyle.io.atomic import atomic_path

SUBCOMMANDS = {
    "check": "what a folder of scenes or styles holds, and what in it is missing or broken",
    "caption": "describe the paintings of a folder by an image-to-text model",
}


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle data``."""
    given = words_of(words)
    name = subcommand("data", __doc__, SUBCOMMANDS, given)
    if name == "check":
        check_command(parse(check_parser(), given[1:]))
    elif name == "caption":
        caption_command(parse(caption_parser(), given[1:]))


def check_parser() -> argparse.ArgumentParser:
    """The words of ``anystyle data check``."""
    words = new_parser("data check", SUBCOMMANDS["check"])
    words.add_argument("path", type=Path, help="a folder")
    words.add_argument(
        "--as",
        dest="layout",
        choices=("scenes", "re10k", "styles", "wikiart", "tables"),
        help="how to read it (default: by itself)",
    )
    words.add_argument("--min-views", type=int, default=2, help="a scene needs so many (default: %(default)s)")
    words.add_argument("--headers", action="store_true", help="do not decode pixels: faster, and truncated files pass")
    words.add_argument("--against", type=Path, help="a folder of test styles: name the pictures that are in both")
    words.add_argument("--write", type=Path, help="write their names to a file, for styles.exclude=[FILE]")
    return words


def check_command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if arguments.layout == "tables" or (arguments.layout is None and is_layout(arguments.path)):
        _check_tables(arguments.path)
        return
    start = time.perf_counter()
    report = check(arguments.path, layout=arguments.layout, min_views=arguments.min_views, decode=not arguments.headers)
    tell(report)
    if arguments.against is not None:
        _overlap(arguments.path, arguments.against, arguments.write)
        if arguments.write is not None and report.layout == "wikiart":
            report.use += f" styles.exclude=[{arguments.write}]"
    print(f"looked at in {time.perf_counter() - start:.1f} s; to train on it: {report.use}")
    if not report.images or (report.layout in ("scenes", "re10k") and not report.scenes):
        raise UserError(f"{arguments.path} holds nothing that can be used")


def tell(report: Report) -> None:
    """Print a report."""
    print(f"layout    {report.layout}")
    if report.layout in ("scenes", "re10k"):
        counts = sorted(report.views.elements())
        least, most = (counts[0], counts[-1]) if counts else (0, 0)
        spread = f", {least} views each" if least == most else f", {least} to {most} views each"
        print(f"scenes    {report.scenes} that can be used, of {len(counts)}{spread}")
    print(f"images    {report.images}")
    for (width, height), count in report.sizes.most_common(5):
        print(f"          {count} of {width} x {height}")
    if len(report.sizes) > 5:
        print(f"          and {len(report.sizes) - 5} more sizes")
    if report.layout in ("scenes", "re10k"):
        print(f"cameras   {report.posed}" + ("" if report.posed else ": training asks for none"))
    if report.layout in ("styles", "wikiart"):
        print(f"texts     {report.texts}")
    print(f"problems  {len(report.problems)}")
    for line in report.problems:
        print(f"          {line}")


def _check_tables(root: Path) -> None:
    """Say what a folder of ``protocol=table2`` holds."""
    layout = Layout(root)
    print("layout    tables")
    for scene in layout.scene_names:
        print(f"content   {scene}: {len(layout.photographs(scene))} of {layout.frames} photographs")
    print(f"styles    {len(layout.style_files)} of {layout.num_styles}")
    print(f"methods   {', '.join(layout.methods) or 'none'}")
    problems = layout.problems()
    print(f"problems  {len(problems)}")
    for line in problems:
        print(f"          {line}")
    if problems:
        raise UserError(f"{root} is not complete for the paper's tables: {problems[0]}")
    print(f"to judge it: anystyle evaluate protocol=table2 root={root}")


def _overlap(root: Path, tests: Path, write: Path | None) -> None:
    pictures = [
        sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES) for folder in (root, tests)
    ]
    if not pictures[1]:
        raise UserError(f"--against {tests}: there are no pictures in it")
    both = same_pictures(*pictures)
    print(f"overlap   {len(both)} of {len(pictures[1])} pictures of {tests}")
    for path, other in both.items():
        print(f"          {path.relative_to(root)} is {other.relative_to(tests)}")
    if write is not None:
        with atomic_path(write) as temporary:
            temporary.write_text("".join(f"{path.relative_to(root).as_posix()}\n" for path in both), encoding="utf-8")


def caption_parser() -> argparse.ArgumentParser:
    """The words of ``anystyle data caption``."""
    words = new_parser("data caption", SUBCOMMANDS["caption"])
    words.add_argument("path", type=Path, help="a folder, walked to any depth")
    words.add_argument(
        "--model", default=DEFAULT_MODEL, help="of the image-text-to-text pipeline (default: %(default)s)"
    )
    words.add_argument("--device", default="cpu", help="where it runs, such as cuda:0 (default: %(default)s)")
    words.add_argument("--out", type=Path, help="the file (default: captions.jsonl in the folder)")
    words.add_argument("--prompt", default=PROMPT, help="what is asked")
    words.add_argument("--batch", type=int, default=8, help="pictures at a time (default: %(default)s)")
    return words


def caption_command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if not arguments.path.is_dir():
        raise UserError(f"there is no folder {arguments.path}")
    out = arguments.out or arguments.path / "captions.jsonl"
    failed = caption_folder(
        arguments.path,
        transformers_captioner(arguments.model, arguments.device),
        out=out,
        prompt=arguments.prompt,
        batch=arguments.batch,
        progress=lambda done, total: print(f"{done}/{total} …", file=sys.stderr, flush=True),
    )
    for name, reason in failed.items():
        print(f"left out: {name}: {reason}", file=sys.stderr)
    print(out)


if __name__ == "__main__":
    run(lambda: main(sys.argv[1:]))
