"""Judge a model on a protocol, or any method's images in folders."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.launch import describe, job_folder, launch, returned
from anystyle.cli.progress import progress_lines
from anystyle.cli.run import run, words_of
from anystyle.evaluation import run as evaluation
from anystyle.evaluation.run import FOLDERS, completed, configured, trained_runs


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle evaluate``; every other word is a Hydra override."""
    flags = new_parser(
        "evaluate",
        "Judge a model on a protocol (protocol=paper_image scenes=folder scenes.root=DIR styles=folder "
        "styles.root=DIR), or any method's images (--content, --style, --stylized; missing=allow if some are absent).",
    )
    flags.add_argument("--content", metavar="DIR", help="photographs: SCENE/FRAME.png")
    flags.add_argument("--style", metavar="DIR", help="style images: STYLE.png")
    flags.add_argument("--stylized", metavar="DIR", help="results: SCENE/STYLE/FRAME.png or SCENE/STYLE_FRAME.png")
    flags.add_argument("--depth", metavar="DIR", help="depth: SCENE/FRAME.npy, and SCENE/cameras.npz if known")
    flags.add_argument("--run", metavar="DIR", dest="trained", help="judge what a training run, or multirun, made")
    flags.add_argument("--out", default=None, help="where the results go (default: evaluation, or in the run)")
    return flags


def job(config: DictConfig, out: str | None, folder: Path | None = None) -> Any:
    """Judge a model, or that of a training in ``folder``; print the table, and return the values of ``objective``."""
    flags: tuple[str, ...] = ()
    if folder is None:
        target = job_folder(out or "evaluation")
    else:
        print(folder, file=sys.stderr)
        target, flags = Path(out or folder / "evaluation"), ("--run", str(folder))
        config = configured(config, folder)
    found = evaluation.run(config, target, flags=flags, on_progress=progress_lines())
    print((target / "table.md").read_text(encoding="utf-8"), end="")
    print(f"\nin {target}: {', '.join(path.name for path in sorted(target.iterdir()) if path.is_file())}")
    return returned(config.objective, found.figures)


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle evaluate``; with ``--run``, once for each run found."""

    def command() -> None:
        flags = parser()
        describe(flags)
        arguments, rest = split(flags, words_of(words))
        if {"-m", "--multirun"} & {*rest}:
            rest = ["hydra.output_subdir=.hydra", *rest]
        given = {name: getattr(arguments, name) for name in FOLDERS if getattr(arguments, name) is not None}
        rest, out = completed(rest, given, arguments.trained), arguments.out
        folders = [None] if arguments.trained is None else trained_runs(Path(arguments.trained))
        for folder in folders:
            one = str(Path(out, folder.name)) if out is not None and folder and len(folders) > 1 else out
            launch("evaluate", lambda config, out=one, folder=folder: job(config, out, folder), rest, out=out)

    run(command)


if __name__ == "__main__":
    main()
