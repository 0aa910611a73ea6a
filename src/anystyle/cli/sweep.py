"""Sweeps that several starts of one command share, on one machine or on several that see the same folder."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins import basic_sweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from omegaconf import OmegaConf

from anystyle.io.atomic import Busy, atomic_path, is_locked
from anystyle.registry.jobs import RECORD


class BasicSweeper(basic_sweeper.BasicSweeper):
    """Hydra's, for jobs that may return :class:`anystyle.io.atomic.Busy`: they are launched again in the end.

    By then the other process has finished them, or has died. Hydra's ``multirun.yaml`` is written whole or not at all,
    and only if it changes.
    """

    __module__ = basic_sweeper.__name__  # Hydra finds its plugins by this name

    def sweep(self, arguments: list[str]) -> list[Sequence[JobReturn]]:
        """Run every combination of the values in ``arguments``, and return what the jobs return, in order."""
        hydra, config, launcher = self.hydra_context, self.config, self.launcher
        assert hydra is not None and config is not None and launcher is not None
        parser = OverridesParser.create(config_loader=hydra.config_loader)
        overrides = parser.parse_overrides([*self._parse_config(), *arguments])
        record, text = Path(config.hydra.sweep.dir, RECORD), OmegaConf.to_yaml(config)
        if not record.is_file() or record.read_text(encoding="utf-8") != text:
            with atomic_path(record) as temporary:
                temporary.write_text(text, encoding="utf-8")
        returned: list[Sequence[JobReturn]] = []
        for batch in self.split_arguments(overrides, self.max_batch_size):
            first = sum(map(len, returned))
            self.validate_batch_is_legal(batch)
            results: list[Any] = list(launcher.launch(batch, initial_job_idx=first))
            for place, words in enumerate(batch):
                # Where a job has failed, this raises its error.
                while isinstance(busy := results[place].return_value, Busy):
                    print(f"waiting for {busy.folder}, where {busy.holder} is at work", file=sys.stderr, flush=True)
                    while is_locked(busy.folder):
                        time.sleep(1)
                    (results[place],) = launcher.launch([words], initial_job_idx=first + place)
            returned.append(results)
        return returned


def register() -> None:
    """Put the sweeper in the place of Hydra's, in this process; calling it again changes nothing."""
    Plugins.instance().register(BasicSweeper)
