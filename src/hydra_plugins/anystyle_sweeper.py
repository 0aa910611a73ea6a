"""Sweeps that several starts of one command share, on one machine or on several that see the same folder.

Hydra finds plugins in the namespace ``hydra_plugins`` alone.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from anystyle.io.atomic import Busy, atomic_path, is_locked
from anystyle.paths import shown
from anystyle.registry.jobs import RECORD, values_of


class SharedSweeper(Sweeper):
    """Every combination of values, as Hydra's own sweeper; jobs may return :class:`anystyle.io.atomic.Busy`.

    Those are launched again when the other process has finished them or has died. ``multirun.yaml`` is written whole or
    not at all, and only if it changes.

    Args:
        max_batch_size: How many jobs the launcher is given at once; ``None`` is all.
        params: More overrides, by their keys.
    """

    def __init__(self, max_batch_size: int | None, params: Mapping[str, str] | None = None) -> None:
        self.max_batch_size, self.params = max_batch_size, params or {}

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.hydra_context, self.config = hydra_context, config
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> list[Sequence[JobReturn]]:
        """Run the jobs, and return what the launcher returned of each batch."""
        assert self.config is not None and self.hydra_context is not None
        record, text = Path(self.config.hydra.sweep.dir, RECORD), OmegaConf.to_yaml(self.config)
        words = [*(f"{key}={value}" for key, value in self.params.items()), *arguments]
        jobs = [[*job] for job in product(*values_of(words, OverridesParser.create(self.hydra_context.config_loader)))]
        if not record.is_file() or record.read_text(encoding="utf-8") != text:
            with atomic_path(record) as temporary:
                temporary.write_text(text, encoding="utf-8")
        size = self.max_batch_size or len(jobs)
        return [self._run(jobs[first : first + size], first) for first in range(0, len(jobs), size)]

    def _run(self, jobs: Sequence[Sequence[str]], first: int) -> Sequence[JobReturn]:
        """Run jobs that are numbered from ``first``."""
        assert self.launcher is not None
        self.validate_batch_is_legal(jobs)
        results: list[Any] = list(self.launcher.launch(jobs, initial_job_idx=first))
        for place, job in enumerate(jobs):
            # Where a job has failed, this raises its error.
            while isinstance(busy := results[place].return_value, Busy):
                print(f"waiting for {shown(busy.folder)}, where {busy.holder} is at work", file=sys.stderr, flush=True)
                while is_locked(busy.folder):
                    time.sleep(1)
                (results[place],) = self.launcher.launch([job], initial_job_idx=first + place)
        return results
