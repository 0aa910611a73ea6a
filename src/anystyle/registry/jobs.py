"""The jobs of a multirun: the overrides of each, the line that announces it, and the command that repeats it."""

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from anystyle.errors import UserError
from anystyle.io.documents import read_yaml

_NOT_REPEATED = ("hydra.mode", "hydra.sweep.", "hydra.job.", "hydra.launcher", "hydra.sweeper")


def values_of(words: Sequence[str], parser: OverridesParser) -> list[list[str]]:
    """For each override of a multirun what its jobs are given; of one key the last counts, as in Hydra's sweeper."""
    values: dict[str, list[str]] = {}
    for item in parser.parse_overrides([*words]):
        key = item.get_key_element()
        several = [f"{key}={value}" for value in item.sweep_string_iterator()] if item.is_sweep_override() else None
        values[key] = several or [str(item.input_line)]
    return [*values.values()]


def swept(folder: Path) -> list[list[str]]:
    """For each override of a multirun what its jobs are given, in Hydra's order; empty where a sweeper decides.

    Hydra writes its record before the first job, over that of an earlier multirun in the same folder.
    """
    try:
        sweep: dict[str, Any] = read_yaml(folder / "multirun.yaml", dict[str, Any], what="multirun's record")["hydra"]
        sweeper = sweep.get("sweeper") or {}
        if not sweeper.get("_target_", "BasicSweeper").endswith("BasicSweeper"):
            return []
        params = [f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()]
        return values_of([*params, *sweep["overrides"]["task"]], OverridesParser.create())
    except (UserError, HydraException, KeyError, TypeError, AttributeError):
        return []


def announcement() -> str:
    """The line with which a job of a multirun begins, such as ``job 3 of 8: placement=head seed=1``."""
    hydra = HydraConfig.get()
    lists = swept(Path(hydra.runtime.cwd, hydra.sweep.dir))
    total = math.prod(map(len, lists)) if lists else hydra.sweeper.get("n_trials")
    varied = {values[0].partition("=")[0] for values in lists if len(values) > 1}
    words = [word for word in hydra.overrides.task if not varied or word.partition("=")[0] in varied]
    return f"job {hydra.job.num + 1}{f' of {total}' if total else ''}: {' '.join(words)}"


def job_overrides() -> list[str]:
    """The overrides of this job, with Hydra's flags that it needs to be repeated by itself."""
    hydra = HydraConfig.get()
    words = [w for w in hydra.overrides.hydra if not w.lstrip("+~").replace("/", ".").startswith(_NOT_REPEATED)]
    folders = [source.path for source in hydra.runtime.config_sources if source.provider == "command-line"]
    return [*hydra.overrides.task, *words, *(f"--config-dir={folder}" for folder in folders)]


def command_line(command: str, *flags: str) -> str:
    """The command that repeats this job by itself; empty where no command is running."""
    return shlex.join(["anystyle", command, *flags, *job_overrides()]) if HydraConfig.initialized() else ""
