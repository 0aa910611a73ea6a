"""Running a command on a configuration composed by Hydra: once, or once for each combination of a multirun."""

import argparse
import functools
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from anystyle import paths
from anystyle.cli.arguments import EPILOG, MODES, is_override, new_parser, split
from anystyle.cli.run import FAILED, run, wants_traceback, words_of
from anystyle.errors import UserError, one_line, unknown
from anystyle.registry.compose import (
    ELSEWHERE,
    VERSION_BASE,
    check_choices,
    check_words,
    choices,
    completed,
    compose,
    config_folders,
    idle,
    override,
    refused,
)
from anystyle.registry.jobs import announcement
from anystyle.registry.packages import groups
from anystyle.registry.source import register


def main(config_name: str, function: Callable[[DictConfig], Any]) -> None:
    """Run a command without flags of its own on the configuration that ``conf/config_name.yaml`` is the root of."""

    def command() -> None:
        flags = new_parser(config_name)
        describe(flags)
        # `--training.learning_rate=1e-4` of a wandb sweep's agent is an override: no flag of these takes a value.
        words = [re.sub(r"^--(?!(cfg|package|info)=)(?=[\w.]+=)", "", word) for word in words_of(None)]
        launch(config_name, function, split(flags, words)[1])

    run(command)


def describe(parser: argparse.ArgumentParser) -> None:
    """Add Hydra's syntax and the configuration groups with their choices to a parser's help."""
    listing = "".join(f"  {group}: {', '.join(choices(group))}\n" for group in groups())
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(filter(None, [parser.epilog, EPILOG, f"Groups:\n{listing}"]))


def launch(
    config_name: str,
    function: Callable[[DictConfig], Any],
    words: Sequence[str],
    folder: Path | None = None,
    out: str | None = None,
) -> None:
    """Hand words to Hydra, which composes what is in ``folder`` (``conf/``) and calls ``function``, for each job.

    The jobs of a multirun write into ``out`` where it is given.
    """
    register()
    if out is not None and {"-m", "--multirun"} & {*words}:
        words = [override("hydra.sweep.dir", out), *words]
    check_words(config_name, words)
    check_choices(words, folder or paths.CONF)
    if len({word.partition("=")[0] for word in words} & {*MODES}) > 1:
        raise UserError(f"give only one of {', '.join(MODES)}")
    if any(word.partition("=")[0] in ("-c", "--cfg") for word in words):
        folders = config_folders(words)
        path = [f"hydra.searchpath=[{','.join(f'file://{each}' for each in folders)}]"] if folders else []
        config = compose(config_name, [*filter(is_override, words), *path], conf=folder)
        words = [*(f"~loss.{name}" for name in sorted(idle(config))), *words]
    failures: list[Exception] = []

    @functools.wraps(function)
    def task(config: DictConfig) -> Any:
        if HydraConfig.get().job.chdir:
            raise JobError(UserError(f"hydra.job.chdir: true: {ELSEWHERE['all']['hydra.job.chdir.true']}"))
        if HydraConfig.get().mode is not RunMode.MULTIRUN:
            try:
                return function(config)
            except Exception as error:
                failures.append(error)
                return None
        job = announcement()
        print(job, file=sys.stderr, flush=True)
        check_objective(config)
        try:
            return function(config)
        except Exception as error:
            print(f"{job} failed: {one_line(error) or type(error).__name__}", file=sys.stderr, flush=True)
            raise JobError(error) from error  # Hydra goes on with the other jobs

    with _for_hydra(completed(words)):
        try:
            hydra.main(config_path=str(folder or paths.CONF), config_name=config_name, **VERSION_BASE)(task)()
        except JobError as failed:
            failures.append(failed.error)
        except BrokenExecutor as error:
            raise UserError(
                "a process of this sweep was killed, perhaps because memory ran out; the same command goes on with "
                "the unfinished jobs"
            ) from error
        except Exception as error:
            raise refused(error) from error
        except SystemExit as end:
            sys.exit(FAILED if end.code == 1 else end.code)  # it has written its line
    if failures:
        raise failures[0]


class JobError(Exception):
    """The error of a job of a multirun, told apart from those that Hydra raises while it composes."""

    def __init__(self, error: Exception) -> None:
        super().__init__(error)
        self.error = error


def check_objective(config: DictConfig) -> None:
    """Refuse a search that would learn nothing from its jobs, before the first of them is run."""
    sweeper = HydraConfig.get().runtime.choices["hydra/sweeper"]
    if sweeper != "basic" and not config.get("objective"):
        raise UserError(
            f"hydra/sweeper={sweeper} compares its jobs by a value; name one that they log, such as "
            "objective=train/loss"
        )


def returned(objective: str | Sequence[str] | None, values: Mapping[str, float]) -> Any:
    """What a job returns to Hydra's sweeper: the value of this name, a list for a list of names, all without one."""
    if objective is None:
        return dict(values)
    for name in [objective] if isinstance(objective, str) else objective:
        if name not in values:
            raise UserError(f"objective: {unknown('value', name, values)}")
    return values[objective] if isinstance(objective, str) else [values[name] for name in objective]


def job_folder(out: str) -> Path:
    """Where results go: ``--out``, and in a multirun a folder of each job's own in it."""
    if not HydraConfig.initialized() or HydraConfig.get().mode is not RunMode.MULTIRUN:
        return Path(out)
    return Path(HydraConfig.get().runtime.output_dir)


@contextmanager
def _for_hydra(words: Sequence[str]) -> Iterator[None]:
    """Hydra reads the process's arguments, and raises instead of printing an error and leaving with status 1.

    The processes that a training starts for more devices inherit both.
    """
    variables = {"HYDRA_FULL_ERROR": "1"} | ({} if wants_traceback() else {"ANYSTYLE_TRACEBACK": "0"})
    argv, before = sys.argv, {name: os.environ.get(name) for name in variables}
    state = HydraConfig.instance()
    running = state.cfg
    sys.argv = [argv[0], *words]
    os.environ.update(variables)
    try:
        yield
    finally:
        sys.argv, state.cfg = argv, running
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def complete(commands: Iterable[str], words: Sequence[str]) -> None:
    """Answer a shell: print its installation script, or the words that may come next.

    Args:
        commands: All commands.
        words: As Hydra takes them: ``install=bash``, ``uninstall=bash`` or ``query=bash``, with the line that is being
            typed in ``COMP_LINE``; likewise for zsh and fish.
    """
    names = list(commands)
    configured = [name for name in names if (paths.CONF / f"{name}.yaml").is_file()]
    command = configured[0]
    if any(word.startswith("query=") for word in words):
        typed = os.environ.get("COMP_LINE", "").split(" ")[1:] or [""]
        if len(typed) < 2:
            print(" ".join(name for name in names if name.startswith(typed[0])))
            return
        if (command := typed[0]) not in configured:
            return
        os.environ["COMP_LINE"] = " ".join(typed)
    launch(command, lambda config: None, ["-sc", *words])
