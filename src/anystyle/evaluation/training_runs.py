"""What training runs made, ready to be judged."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from anystyle.documents import read_json
from anystyle.evaluation.runs import job_order
from anystyle.io.checkpoint import Header, read_header

BRANCH = "branch.safetensors"


@dataclass(frozen=True)
class TrainedRun:
    """A run that wrote a style branch.

    Args:
        folder: Of the run.
        branch: Its weights.
        header: What they say of themselves.
        weights: Names or files of the other parts, as the run was configured.
    """

    folder: Path
    branch: Path
    header: Header
    weights: dict[str, Any]

    def into(self, config: DictConfig) -> DictConfig:
        """A configuration with the parts, options and weights of this run."""
        merged = config.copy()
        with open_dict(merged):
            for part, node in self.header.config.items():
                merged[part] = OmegaConf.create(node) if isinstance(node, dict) else node
            merged.weights = {**self.weights, "branch": str(self.branch)}
        return merged


def trained_runs(folder: Path) -> list[TrainedRun]:
    """The runs in a folder: itself, or the jobs of a multirun, in order.

    Raises:
        ValueError: None of them is finished.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no run {folder}")
    jobs = sorted((path.parent for path in folder.glob(f"*/{BRANCH}")), key=job_order)
    folders = [folder] if (folder / BRANCH).is_file() else jobs
    if not folders:
        raise ValueError(f"{folder} holds no finished training of a style branch ({BRANCH}, in it or in its jobs)")
    return [_run(folder) for folder in folders]


def _run(folder: Path) -> TrainedRun:
    record = folder / "bound.json"
    what = "record of a run, which says on which weights it was trained"
    bound: dict[str, Any] = read_json(record, dict[str, Any], what=what)
    weights = {key.removeprefix("weights."): value for key, value in bound.items() if key.startswith("weights.")}
    return TrainedRun(folder, folder / BRANCH, read_header(folder / BRANCH), weights)
