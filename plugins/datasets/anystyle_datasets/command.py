"""The command ``anystyle data``."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from anystyle.cli.arguments import new_parser, parse, split, subcommand
from anystyle.cli.progress import progress_lines
from anystyle.contracts import Command
from anystyle.errors import UserError
from anystyle.evaluation.paper_folder import PaperFolder
from anystyle.registry.compose import compose, override
from anystyle.training.run import make_sources
from anystyle_datasets import preparing
from anystyle_datasets.captioning import DEFAULT_MODEL, PROMPT, caption_folder, chat_captioner, transformers_captioner
from anystyle_datasets.checking import (
    FolderReport,
    check,
    check_shards,
    guess,
    is_sharded,
    locate,
    same_pictures,
    words,
)  # fmt: skip
from anystyle_datasets.files import pictures_below, write_lines
from anystyle_datasets.packing import pack
from anystyle_datasets.preparing import ARCHIVE
from anystyle_datasets.wikiart import DESCRIPTIONS

SUBCOMMANDS = {
    "prepare": "convert a published data set to what the loaders read; nothing is downloaded",
    "check": "what a folder of scenes or styles holds, and what in it is missing or damaged",
    "caption": "describe the paintings of a folder by an image-to-text model",
    "shard": "put scenes and styles into shards, which trainings also read from object storage",
}


class Data(Command):
    """Prepare training data, check it before it is trained on, and describe paintings."""

    def __call__(self, words: Sequence[str]) -> None:
        name = subcommand("data", self.__doc__, SUBCOMMANDS, words)
        if name is None:
            return
        flags = new_parser(f"data {name}", SUBCOMMANDS[name])
        add = flags.add_argument
        if name == "check":
            layouts = ("scenes", "re10k", "styles", "wikiart", "tables")
            add("path", type=_place, help="a folder, or the address of one of shards")
            add("--as", dest="layout", choices=layouts, help="how to read it (default: recognised)")
            add("--min-views", type=int, default=2, help="views that a scene needs (default: %(default)s)")
            add("--headers", action="store_true", help="do not decode pixels: faster, but misses truncated files")
            add("--against", type=Path, help="a folder of test styles: name the pictures that are in both")
            add("--write", type=Path, help="write their names to a file, for styles.exclude=[FILE]")
            check_command(parse(flags, words[1:]))
        elif name == "prepare":
            add("kind", choices=sorted(KINDS), help="of data")
            add("path", type=Path, help="a folder; missing files are made in it, existing ones are kept")
            add("--archive", type=Path, help=f"the authors' {ARCHIVE} (wikiart, tables)")
            add("--stylos", type=Path, help="Stylos' folder of 50 test styles: kept out (wikiart), or copied (tables)")
            add("--styl3r", type=Path, help="a folder with Styl3R's test styles: kept out (wikiart)")
            add("--captures", type=Path, nargs="+", default=[], help="folders with the tables' scenes (tables)")
            prepare_command(parse(flags, words[1:]))
        elif name == "shard":
            add("out", type=Path, help="a folder: scenes are put into OUT/scenes, styles into OUT/styles")
            add("--megabytes", type=int, default=1024, help="after which a shard is closed (default: %(default)s)")
            shard_command(*split(flags, words[1:]))
        else:
            add("path", type=Path, help="a folder, walked to any depth")
            add("--model", default=DEFAULT_MODEL, help="a name on the hub, or a folder (default: %(default)s)")
            add("--trust-remote-code", action="store_true", help="run code that the model's page brings")
            add("--device", default="cpu", help="where it runs, such as cuda:0 (default: %(default)s)")
            add("--out", type=Path, help="the file (default: that which the folder's layout has)")
            add("--prompt", default=PROMPT, help="the question to the model")
            add("--batch", type=int, default=8, help="pictures at a time (default: %(default)s)")
            caption_command(parse(flags, words[1:]))


def _place(word: str) -> Path | str:
    """A path, or an address as it is: a path would lose one of its slashes."""
    return word if "://" in word else Path(word)


KINDS: dict[str, Callable[..., str]] = {
    "dl3dv": preparing.dl3dv,
    "re10k": preparing.re10k,
    "styles": preparing.styles,
    "tables": preparing.tables,
    "wikiart": preparing.wikiart,
}
"""What prepares each kind of data; its keywords are the flags that are its own."""


def prepare_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle data prepare``."""
    given = {name: value for name, value in vars(arguments).items() if value and name not in ("kind", "path")}
    takers = {name: [kind for kind, make in KINDS.items() if name in signature(make).parameters] for name in given}
    for name, kinds in takers.items():
        if arguments.kind not in kinds:
            raise UserError(f"--{name} is for {' and '.join(kinds)}, not for {arguments.kind}")
        for path in given[name] if isinstance(given[name], list) else [given[name]]:
            if not path.exists():
                raise UserError(f"--{name} {path}: that is not there")
    if arguments.kind != "tables" and not arguments.path.is_dir():
        raise UserError(f"there is no folder {arguments.path}")
    root = locate(arguments.path) if arguments.path.is_dir() else arguments.path
    print(KINDS[arguments.kind](root, progress_lines(), **given))
    print(f"next      {shlex.join(['anystyle', 'data', 'check', str(root)])}")


def check_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle data check``."""
    root, write = arguments.path, arguments.write
    start = time.perf_counter()
    if isinstance(root, str) or is_sharded(root):
        if arguments.against is not None:
            raise UserError("--against compares folders of pictures, not shards")
        report = check_shards(str(root), arguments.min_views, not arguments.headers, progress_lines())
        print("\n".join([*lines(report), f"checked in {time.perf_counter() - start:.1f} s"]))
        if report.damaged:
            raise UserError(
                f"{report.damaged} samples of {root} are damaged: copy its shards again, or write them again"
            )
        print(f"next      anystyle train experiment=paper_head {report.use}")
        return
    has_tables = (root / "content").is_dir() and PaperFolder(root).styles.is_dir()
    if arguments.layout == "tables" or (arguments.layout is None and has_tables):
        _check_tables(root)
        return
    report = check(root, layout=arguments.layout, min_views=arguments.min_views, decode=not arguments.headers)
    print("\n".join(lines(report)))
    if arguments.against is not None:
        _overlap(root, arguments.against, write)
        report.use += f" styles.exclude=[{write}]" if write is not None and report.layout == "wikiart" else ""
    print(f"checked in {time.perf_counter() - start:.1f} s")
    if not report.prepare and (not report.images or (report.layout in ("scenes", "re10k") and not report.scenes)):
        raise UserError(f"{root} holds nothing that can be used")
    print(f"next      {report.prepare or f'anystyle train experiment=paper_head {report.use}'}")


def lines(report: FolderReport) -> Iterator[str]:
    """A report as lines of a label and a value."""
    scenes = report.layout in ("scenes", "re10k")
    yield f"layout    {report.layout}" + (f" in {report.shards} shards" if report.shards else "")
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
    print(f"next      anystyle evaluate {words(protocol='table2', root=root)}")


def _overlap(root: Path, tests: Path, write: Path | None) -> None:
    train, test = pictures_below(root), pictures_below(tests)
    if not test:
        raise UserError(f"--against {tests}: there are no pictures in it")
    both = same_pictures(train, test)
    print(f"overlap   {len(both)} of {len(test)} pictures of {tests}")
    for path, other in both.items():
        print(f"          {path.relative_to(root)} is {other.relative_to(tests)}")
    if write is not None:
        write_lines(write, (path.relative_to(root).as_posix() for path in both))


OPTIONS = ("short_side", "multiple", "size", "crop")
"""Options that shards keep of the source that was packed."""


def shard_command(arguments: argparse.Namespace, overrides: Sequence[str]) -> None:
    """Run ``anystyle data shard``, whose overrides are those of a training."""
    if arguments.megabytes < 1:
        raise UserError(f"--megabytes {arguments.megabytes}: a number above 0 is expected")
    named = {"name": "shards", "out": str(arguments.out)}
    config = compose("train", [*(override(key, value) for key, value in named.items()), *overrides])
    sources = {key: source for key, source in make_sources(config).items() if source is not None}
    if not sources:
        raise UserError("say what to pack in the words of a training, such as scenes=dl3dv scenes.root=DL3DV-10K")
    use: dict[str, object] = {}
    for key, source in sources.items():
        out = arguments.out / key
        node: Any = OmegaConf.to_container(config[key], resolve=True, enum_to_str=True)
        options = {name: node[name] for name in OPTIONS if name in node}
        index = pack(source, out, options=options, megabytes=arguments.megabytes, on_progress=progress_lines())
        print(f"{key:<9} {len(index.names)} in {len(index.shards)} shards, {sum(index.shards) / 2**20:,.1f} MiB: {out}")
        use |= {key: "shards", f"{key}__root": out}
    print(f"next      anystyle train {words(**use)}")


def caption_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle data caption``."""
    if not arguments.path.is_dir():
        raise UserError(f"there is no folder {arguments.path}")
    if arguments.model == DEFAULT_MODEL and not arguments.trust_remote_code:
        raise UserError(
            f"{DEFAULT_MODEL}, which the paper's captions are of, runs code that its page brings: allow that by "
            f"--trust-remote-code, or name another model, such as --model HuggingFaceTB/SmolVLM-Instruct"
        )
    captioner = chat_captioner if arguments.trust_remote_code else transformers_captioner
    out = arguments.out or arguments.path / (DESCRIPTIONS if guess(arguments.path) == "wikiart" else "captions.jsonl")
    failed = caption_folder(
        arguments.path,
        captioner(arguments.model, arguments.device),
        out=out,
        prompt=arguments.prompt,
        batch=arguments.batch,
        on_progress=progress_lines(),
    )
    for name, reason in failed.items():
        print(f"left out: {name}: {reason}", file=sys.stderr)
    print(out)
