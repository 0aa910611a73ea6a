"""Trainings whose style branch ``anystyle evaluate --run`` judges."""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from anystyle.errors import UserError
from anystyle.evaluation.runs import job_order
from anystyle.io.checkpoint import read_header
from anystyle.io.documents import read_json
from anystyle.registry.untrusted import check_saved

BRANCH = "branch.safetensors"


def trained_runs(folder: Path) -> list[Path]:
    """The folders that hold a style branch: a run itself, or the jobs of a multirun in order."""
    if not folder.is_dir():
        raise UserError(f"there is no run {folder}")
    jobs = sorted((path.parent for path in folder.glob(f"*/{BRANCH}")), key=job_order)
    folders = [folder] if (folder / BRANCH).is_file() else jobs
    if not folders:
        raise UserError(f"{folder} holds no finished training of a style branch ({BRANCH}, in it or in its jobs)")
    return folders


def configured(config: DictConfig, folder: Path) -> DictConfig:
    """A configuration with the parts, options and weights of a run."""
    what = "record of a run, which names the weights it was trained on"
    bound: dict[str, Any] = read_json(folder / "bound.json", dict[str, Any], what=what)
    saved = read_header(folder / BRANCH).config
    check_saved(saved, folder / BRANCH)
    merged = config.copy()
    with open_dict(merged):
        for part, node in saved.items():
            merged[part] = OmegaConf.create(node) if isinstance(node, dict) else node
        weights = {key.removeprefix("weights."): value for key, value in bound.items() if key.startswith("weights.")}
        merged.weights = {**weights, "branch": str(folder / BRANCH)}
    return merged
