"""Judge a model on a protocol, or any method's images in folders."""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.launch import describe, job_folder, launch, returned
from anystyle.cli.progress import progress_lines
from anystyle.cli.run import run, words_of
from anystyle.errors import UserError
from anystyle.evaluation.layout import DEFAULTS
from anystyle.pipeline.trained import configured, trained_runs
from anystyle.registry.compose import check_choices

if TYPE_CHECKING:  # torch takes seconds, in which a mistyped word is answered
    from anystyle.evaluation.run import Images


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle evaluate``; every other word is a Hydra override."""
    flags = new_parser(
        "evaluate",
        "Judge a model on a protocol (protocol=paper_image scenes=folder scenes.root=DIR styles=folder "
        "styles.root=DIR), or any method's images (--content, --style, --stylized; missing=allow if some are absent).",
    )
    flags.add_argument("--content", metavar="DIR", help="photographs: SCENE/FRAME.png")
    flags.add_argument("--style", metavar="DIR", help="style images: STYLE.png")
    flags.add_argument("--stylized", metavar="DIR", help="results of any method")
    flags.add_argument(
        "--layout",
        metavar="PATTERN",
        help="how results are named, such as '{scene}_{style}/*/{frame}', where * is any text "
        f"(default: {', '.join(DEFAULTS)})",
    )
    flags.add_argument("--depth", metavar="DIR", help="depth: SCENE/FRAME.npy, and SCENE/cameras.npz if known")
    flags.add_argument("--run", metavar="DIR", dest="trained", help="judge what a training run, or multirun, made")
    flags.add_argument("--out", default=None, help="where the results go (default: evaluation, or in the run)")
    return flags


def job(config: DictConfig, images: "Images | None", folder: Path | None, out: str | None) -> Any:
    """Judge images, or the model of a training in ``folder``, or one that is configured.

    Prints the table, and returns the values of ``objective``.
    """
    from anystyle.evaluation import run as evaluation

    target, flags = job_folder(out or "evaluation"), list[str]()
    if images is not None:
        config, flags = images.configured(config), images.flags
    if folder is not None:
        print(folder, file=sys.stderr)
        target, flags = Path(out or folder / "evaluation"), ["--run", str(folder)]
        config = configured(config, folder)
    found = evaluation.run(config, target, flags=flags, on_progress=progress_lines())
    print((target / "table.md").read_text(encoding="utf-8"), end="")
    print(f"\nin {target}: {', '.join(path.name for path in sorted(target.iterdir()) if path.is_file())}")
    return returned(config.objective, found.scores)


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle evaluate``; with ``--run``, once for each run found."""

    def command() -> None:
        flags = parser()
        describe(flags)
        arguments, rest = split(flags, words_of(words))
        if {"-m", "--multirun"} & {*rest}:
            rest = ["hydra.output_subdir=.hydra", *rest]
        check_choices(rest)
        from anystyle.evaluation.run import RUN_OR_IMAGES, Images

        given = (getattr(arguments, name) for name in ("content", "style", "stylized", "depth", "layout"))
        images, out = Images.of(*given), arguments.out
        if images is not None:
            rest = [*Images.WORDS, *rest]
            if arguments.trained is not None:
                raise UserError(RUN_OR_IMAGES)
        folders = [None] if arguments.trained is None else trained_runs(Path(arguments.trained))
        for folder in folders:
            one = str(Path(out, folder.name)) if out is not None and folder and len(folders) > 1 else out
            launch("evaluate", partial(job, images=images, folder=folder, out=one), rest, out=out)

    run(command)


if __name__ == "__main__":
    main()
