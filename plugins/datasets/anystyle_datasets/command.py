"""The command ``anystyle data``."""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from anystyle.commands._flags import new_parser, parse, subcommand
from anystyle.data.images import SUFFIXES
from anystyle.errors import UserError
from anystyle.evaluation.paper_folder import PaperFolder, is_paper_folder
from anystyle.io.atomic import atomic_path
from anystyle.registry.socket import Command
from anystyle_datasets.captioning import DEFAULT_MODEL, PROMPT, caption_folder, transformers_captioner
from anystyle_datasets.checking import Report, check, same_pictures

SUBCOMMANDS = {
    "check": "what a folder of scenes or styles holds, and what in it is missing or damaged",
    "caption": "describe the paintings of a folder by an image-to-text model",
}


class Data(Command):
    """Check training data before it is trained on, and describe paintings."""

    def __call__(self, words: Sequence[str]) -> None:
        name = subcommand("data", self.__doc__, SUBCOMMANDS, words)
        if name is None:
            return
        flags = new_parser(f"data {name}", SUBCOMMANDS[name])
        add = flags.add_argument
        if name == "check":
            layouts = ("scenes", "re10k", "styles", "wikiart", "tables")
            add("path", type=Path, help="a folder")
            add("--as", dest="layout", choices=layouts, help="how to read it (default: recognised)")
            add("--min-views", type=int, default=2, help="views that a scene needs (default: %(default)s)")
            add("--headers", action="store_true", help="do not decode pixels: faster, but misses truncated files")
            add("--against", type=Path, help="a folder of test styles: name the pictures that are in both")
            add("--write", type=Path, help="write their names to a file, for styles.exclude=[FILE]")
            check_command(parse(flags, words[1:]))
        else:
            add("path", type=Path, help="a folder, walked to any depth")
            add("--model", default=DEFAULT_MODEL, help="of the image-text-to-text pipeline (default: %(default)s)")
            add("--device", default="cpu", help="where it runs, such as cuda:0 (default: %(default)s)")
            add("--out", type=Path, help="the file (default: captions.jsonl in the folder)")
            add("--prompt", default=PROMPT, help="the question to the model")
            add("--batch", type=int, default=8, help="pictures at a time (default: %(default)s)")
            caption_command(parse(flags, words[1:]))


def check_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle data check``."""
    root, write = arguments.path, arguments.write
    if arguments.layout == "tables" or (arguments.layout is None and is_paper_folder(root)):
        _check_tables(root)
        return
    start = time.perf_counter()
    report = check(root, layout=arguments.layout, min_views=arguments.min_views, decode=not arguments.headers)
    print("\n".join(lines(report)))
    if arguments.against is not None:
        _overlap(root, arguments.against, write)
        report.use += f" styles.exclude=[{write}]" if write is not None and report.layout == "wikiart" else ""
    print(f"checked in {time.perf_counter() - start:.1f} s; to train on it: {report.use}")
    if not report.images or (report.layout in ("scenes", "re10k") and not report.scenes):
        raise UserError(f"{root} holds nothing that can be used")


def lines(report: Report) -> Iterator[str]:
    """A report as lines of a label and a value."""
    scenes = report.layout in ("scenes", "re10k")
    yield f"layout    {report.layout}"
    if scenes:
        counts = sorted(report.views.elements()) or [0]
        each = f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
        yield f"scenes    {report.scenes} that can be used, of {report.views.total()}, {each} views each"
    yield f"images    {report.images}"
    yield from (f"          {count} of {width} x {height}" for (width, height), count in report.sizes.most_common(5))
    if len(report.sizes) > 5:
        yield f"          and {len(report.sizes) - 5} more sizes"
    if scenes:
        yield f"cameras   {report.posed}" + ("" if report.posed else ": training needs none")
    else:
        yield f"texts     {report.texts}"
    yield "\n          ".join([f"problems  {len(report.problems)}", *report.problems])


def _check_tables(root: Path) -> None:
    layout = PaperFolder(root)
    print("layout    tables")
    for scene in layout.scene_names:
        print(f"content   {scene}: {len(layout.photographs(scene))} of {layout.frames} photographs")
    print(f"styles    {len(layout.style_files)} of {layout.num_styles}")
    print(f"methods   {', '.join(layout.methods) or 'none'}")
    problems = layout.problems()
    print("\n          ".join([f"problems  {len(problems)}", *problems]))
    if problems:
        raise UserError(f"{root} is not complete for the paper's tables: {problems[0]}")
    print(f"to evaluate it: anystyle evaluate protocol=table2 root={root}")


def _overlap(root: Path, tests: Path, write: Path | None) -> None:
    train, test = (
        sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES) for folder in (root, tests)
    )
    if not test:
        raise UserError(f"--against {tests}: there are no pictures in it")
    both = same_pictures(train, test)
    print(f"overlap   {len(both)} of {len(test)} pictures of {tests}")
    for path, other in both.items():
        print(f"          {path.relative_to(root)} is {other.relative_to(tests)}")
    if write is not None:
        with atomic_path(write) as temporary:
            temporary.write_text("".join(f"{path.relative_to(root).as_posix()}\n" for path in both), encoding="utf-8")


def caption_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle data caption``."""
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
