"""Trainings and commands in processes of their own."""

import multiprocessing
import os
import resource
import socket
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

MEMORY = 8 << 30
"""Bytes that a command may take."""
new = multiprocessing.get_context("spawn")
"""Where processes begin that share nothing with this one."""


def start(
    words: Sequence[str], out: Path, environment: Mapping[str, str] | None = None, largest: int | None = None
) -> BaseProcess:
    """A training at work, or about to be; no file that it writes may have more than ``largest`` bytes."""
    process = new.Process(target=_train, args=(tuple(words), out, dict(environment or {}), largest), daemon=True)
    process.start()
    return process


def command(
    words: Sequence[str], folder: Path, output: Path, environment: Mapping[str, str] | None = None
) -> BaseProcess:
    """``anystyle WORDS`` at work in a folder; both streams go to ``output``."""
    process = new.Process(target=_command, args=(tuple(words), folder, output, dict(environment or {})))
    process.start()
    return process


def together(count: int, words: Sequence[str], out: Path) -> list[BaseProcess]:
    """The processes of one distributed training, as torchrun starts them."""
    places = meeting(count)
    words = (*words, f"trainer.devices={count}")
    return [start(words, out, places | {"LOCAL_RANK": str(rank), "RANK": str(rank)}) for rank in range(count)]


def meeting(count: int) -> dict[str, str]:
    """Where so many processes meet, as torchrun tells them."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(count)}


def said(out: Path) -> str:
    """What the trainings in a folder have written on their terminals."""
    return "".join(path.read_text() for path in sorted(out.glob("process_*.txt")))


def _command(words: Sequence[str], folder: Path, output: Path, environment: Mapping[str, str]) -> None:
    from anystyle.__main__ import main

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    log = os.open(output, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.chdir(folder)
    os.environ.update(environment)
    sys.argv = ["anystyle", *words]
    main()


def _train(words: Sequence[str], out: Path, environment: Mapping[str, str], largest: int | None) -> None:
    import torch

    from anystyle.cli.run import run
    from anystyle.training.run import train
    from tests.support.training_cases import configuration

    os.environ.update(environment)
    torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    log = os.open(out / f"process_{os.getpid()}.txt", os.O_CREAT | os.O_WRONLY)
    os.dup2(log, 1)
    os.dup2(log, 2)
    if largest is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    run(lambda: train(configuration(words, out), out))
