"""The smallest sweep: jobs of the toy training."""

import atexit
import ctypes
import os
import resource
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from joblib.externals.loky.backend.context import set_start_method

from anystyle.__main__ import main
from anystyle.io import atomic

LEASE = 10.0
"""Seconds after which a lock that is not refreshed is taken over here; users wait for a minute."""
_PLUGIN = """
from anystyle.io import atomic
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.training import ToyTraining

atomic.LEASE = {lease}
"""
_KINDS = {"backbone": "ToyBackbone", "scenes": "ToyScenes", "training": "ToyTraining"}
_NEW_HOST = 0x04000000  # CLONE_NEWUTS of Linux


def write_plugin(folder: Path, lease: float = LEASE) -> dict[str, str]:
    """Write a plugin of the toys into a folder, which also sets the lease; returns what the environment then needs."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f'[project.entry-points."anystyle.{kind}"]\ntoy = "toys:{name}"\n' for kind, name in _KINDS.items()]
    (folder / "pyproject.toml").write_text('[project]\nname = "toys"\nversion = "1"\n' + "".join(lines))
    (folder / "toys.py").write_text(_PLUGIN.format(lease=lease))
    return {"ANYSTYLE_PLUGINS": str(folder)}


def sweep_words(folder: Path | str, seeds: str = "0,1,2") -> list[str]:
    """The words of the sweep, after the launcher's: four jobs for each seed."""
    return [
        "training=toy", "backbone=toy", "scenes=toy", "weights.backbone=null", "loss=[]", "scenes.size=[16,16]",
        "trainer.max_steps=8", "trainer.log_every_n_steps=1", "checkpoint.every_steps=1", f"seed={seeds}",
        "training.learning_rate=0.001,0.002,0.003,0.004", f"hydra.sweep.dir={folder}",
    ]  # fmt: skip


def run(
    words: Sequence[str], folder: Path, output: Path, environment: Mapping[str, str], host: str | None = None
) -> None:
    """``anystyle WORDS`` in this process, which is forked: the head of a group, on a host of another name where given.

    Workers of joblib are forked too, which have imported what this process has.
    """
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets what it starts behind itself ignore it
    if host is not None:
        assert ctypes.CDLL(None, use_errno=True).unshare(_NEW_HOST) == 0, os.strerror(ctypes.get_errno())
        socket.sethostname(host)
    log = os.open(output, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.chdir(folder)
    os.environ.update(environment)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.filterwarnings("ignore", message="`fork` start method")
    set_start_method("fork")
    # As in those that joblib starts otherwise.
    os.register_at_fork(after_in_child=lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL) and None)
    atomic.LEASE = LEASE
    sys.argv = ["anystyle", *words]
    try:
        main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0
    # As an interpreter ends; a process of multiprocessing would wait for joblib's workers.
    threading._shutdown()  # pyright: ignore
    atexit._run_exitfuncs()
    os._exit(status)
