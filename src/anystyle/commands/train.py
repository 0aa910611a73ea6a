"""Train a component, or resume its training: every word is a Hydra override."""

import contextlib
import logging
import signal
import sys
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from anystyle.cli.launch import main, returned
from anystyle.errors import UserError
from anystyle.io.atomic import write_text
from anystyle.paths import shown


def run(config: DictConfig) -> Any:
    """Train, print where the results are, and return the values of ``objective``."""
    out = Path(config.out)
    try:
        return _run(config, out)
    finally:
        with contextlib.suppress(OSError):
            out.rmdir()  # Hydra makes both; a run that was refused leaves nothing
            if HydraConfig.get().mode is not RunMode.MULTIRUN:  # whose folder the sweeper still writes into
                out.parent.rmdir()


def _run(config: DictConfig, out: Path) -> Any:
    check_devices(config)
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    for name in ("profilers", "callbacks.model_summary"):  # what trainer.profiler and enable_model_summary print
        logging.getLogger(f"lightning.pytorch.{name}").setLevel(logging.INFO)

    def on_begin(step: int) -> None:
        write_hydra_files(config, out)
        if 0 < step < config.trainer.max_steps:
            print(f"resuming from step {step} of {config.trainer.max_steps}", file=sys.stderr, flush=True)

    from anystyle.training.run import train  # Lightning takes seconds, in which a mistyped word is answered

    outcome = train(config, out, on_begin)
    if outcome.rank_zero and outcome.finished:
        names = ", ".join(path.name for path in outcome.weights) or "no weights kept"
        print(f"{outcome.steps} steps done; {names} in {shown(out)}")
    elif outcome.rank_zero:
        print(f"stopped after step {outcome.steps}; the same command resumes from {shown(out)}")
    if outcome.stopped_by is not None:
        if HydraConfig.get().mode is RunMode.MULTIRUN:
            raise KeyboardInterrupt  # the jobs that follow are left for the next start
        sys.exit(128 + signal.Signals[outcome.stopped_by])
    return returned(config.objective, outcome.metrics)


def write_hydra_files(config: DictConfig, out: Path) -> None:
    """Write the configuration and the overrides into the run's ``.hydra``, which Hydra itself does before checks."""
    hydra = HydraConfig.instance().cfg
    files = {"config.yaml": config, "hydra.yaml": hydra, "overrides.yaml": HydraConfig.get().overrides.task}
    for name, content in files.items():
        write_text(out / ".hydra" / name, OmegaConf.to_yaml(content))


def check_devices(config: DictConfig) -> None:
    """Refuse several devices inside a multirun, unless the launcher runs each job as a process of its own."""
    state = HydraConfig.get()
    single = config.trainer.devices in (1, "1") and config.trainer.num_nodes == 1
    launcher = str(state.runtime.choices.get("hydra/launcher"))
    if state.mode is RunMode.MULTIRUN and not single and not launcher.startswith("submitit"):
        raise UserError(
            f"trainer.devices={config.trainer.devices} inside a multirun would start the sweep again in every "
            "process; use hydra/launcher=submitit_slurm, or trainer.devices=1"
        )


if __name__ == "__main__":
    main("train", run)
