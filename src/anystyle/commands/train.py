"""Train a component, or continue to: every word is a Hydra override."""

import contextlib
import logging
import signal
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from anystyle.commands._compose import main
from anystyle.io.atomic import atomic_path
from anystyle.paths import shown
from anystyle.training.pipeline import forwarded, stages_of, train_pipeline
from anystyle.training.run import train


def run(config: DictConfig) -> dict[str, float]:
    """Train, and say where the results are.

    Raises:
        ValueError: Several devices are asked for inside a multirun.
        KeyboardInterrupt: A signal ended a job of a multirun; those that follow are left for the next start.
    """
    check_devices(config)
    if config.pipeline is not None:
        run_pipeline(config)
        return {}
    # Lightning tells what it does; the run's own lines say what matters.
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    out = Path(config.out)
    try:
        outcome = train(config, out, lambda: keep_words(config, out))
    finally:
        with contextlib.suppress(OSError):
            out.rmdir()  # Hydra makes it; a run that was refused leaves nothing
    where = shown(Path(config.out))
    if outcome.leading and outcome.finished:
        names = ", ".join(path.name for path in outcome.weights) or "nothing to keep"
        print(f"{outcome.steps} steps done; {names} in {where}")
    elif outcome.leading:
        print(f"stopped after step {outcome.steps}; the same command continues from {where}")
    if outcome.stopped_by is not None:
        if HydraConfig.get().mode is RunMode.MULTIRUN:
            raise KeyboardInterrupt
        sys.exit(128 + signal.Signals[outcome.stopped_by])
    return dict(outcome.metrics)


def keep_words(config: DictConfig, out: Path) -> None:
    """Write what the run was started with into its folder ``.hydra``, as Hydra itself does before it is checked."""
    hydra = HydraConfig.instance().cfg
    files = {"config.yaml": config, "hydra.yaml": hydra, "overrides.yaml": HydraConfig.get().overrides.task}
    for name, content in files.items():
        with atomic_path(out / ".hydra" / name) as temporary:
            temporary.write_text(OmegaConf.to_yaml(content), encoding="utf-8")


def run_pipeline(config: DictConfig) -> None:
    """Run several trainings, each of which starts from the weights that earlier ones exported."""
    stages = stages_of({str(name): dict(exports) for name, exports in config.pipeline.items()})
    files = train_pipeline(stages, forwarded(HydraConfig.get().overrides.task), Path(config.out))
    print(f"{len(files)} trainings done; {', '.join(path.name for path in files)} in {shown(files[0].parent)}")


def check_devices(config: DictConfig) -> None:
    """Refuse what would start the sweep again in every process.

    Raises:
        ValueError: Several devices are asked for inside a multirun whose jobs are not processes of their own.
    """
    state = HydraConfig.get()
    single = config.trainer.devices in (1, "1") and config.trainer.num_nodes == 1
    launcher = str(state.runtime.choices.get("hydra/launcher"))
    if state.mode is RunMode.MULTIRUN and not single and not launcher.startswith("submitit"):
        raise ValueError(
            f"trainer.devices={config.trainer.devices} inside a multirun would start the sweep again in every "
            "process; use hydra/launcher=submitit_slurm, or trainer.devices=1"
        )


if __name__ == "__main__":
    main("train", run)
