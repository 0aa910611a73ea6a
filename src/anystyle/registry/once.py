"""A configuration is composed once where Hydra composes it twice: to look at it, and again to run it.

Before every run Hydra composes all of it to see whether it says ``hydra.mode``; before every sweep each job, to see
whether it can be composed. What was composed to be looked at is handed out when the same words are composed to run.
"""

import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.hydra import Hydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.plugins.sweeper import Sweeper
from hydra.types import RunMode
from omegaconf import DictConfig

_MOST = 64
"""Configurations of a sweep that are kept at most; jobs beyond are composed again."""
_looked_at: dict[tuple[str | None, tuple[str, ...]], DictConfig] = {}

_load = ConfigLoaderImpl.load_configuration
_get_mode = Hydra.get_mode
_SINGLE = "hydra.mode=RUN"


@functools.wraps(_load)
def _load_once(
    self: ConfigLoaderImpl, config_name: str | None, overrides: list[str], run_mode: RunMode, *args: Any, **options: Any
) -> DictConfig:
    kept = _looked_at.pop((config_name, tuple(overrides)), None) if run_mode is RunMode.RUN else None
    return _load(self, config_name, overrides, run_mode, *args, **options) if kept is None else kept


def _mode(self: Hydra, config_name: str | None, overrides: list[str]) -> Any:
    """What ``hydra.mode`` a configuration says; ``None`` where it says nothing, or cannot be composed."""
    try:
        if any(word.is_sweep_override() for word in OverridesParser.create().parse_overrides(overrides)):
            return _get_mode(self, config_name, overrides)
        config = self.config_loader.load_configuration(config_name, list(overrides), RunMode.RUN)
    except Exception:
        return None  # as Hydra does: the run composes it again, and says what is wrong
    mode = config.hydra.mode
    if mode is None:
        # As Hydra is about to ask for it.
        config.hydra.mode = RunMode.RUN
        config.hydra.overrides.hydra.append(_SINGLE)
        _looked_at[config_name, (*overrides, _SINGLE)] = config
    return mode


def _validate(self: Sweeper, batch: Sequence[Sequence[str]]) -> None:
    """Compose each job of a sweep before the first one runs."""
    sweeper: Any = self  # its context is set up by now
    loader, master = sweeper.hydra_context.config_loader, sweeper.config
    for overrides in batch:
        config = loader.load_sweep_config(master, list(overrides))
        if len(_looked_at) < _MOST:
            words = (*master.hydra.overrides.hydra, *overrides)
            _looked_at[master.hydra.job.config_name, words] = config


@contextmanager
def looking() -> Iterator[None]:
    """Keep what is looked at until the command is over; files and environment may change after it."""
    try:
        yield
    finally:
        _looked_at.clear()


# Once a process, when this file is imported.
ConfigLoaderImpl.load_configuration = _load_once
Hydra.get_mode = _mode
Sweeper.validate_batch_is_legal = _validate
