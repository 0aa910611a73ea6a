"""The style branches of finished trainings, with the parts and weights that they were trained with."""

import logging
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.io.run_folder import RECORD
from anystyle.paths import natural

_log = logging.getLogger(__name__)

BRANCH = "branch.safetensors"
"""What a training exports."""


def trained_runs(folder: Path) -> list[Path]:
    """The folders that hold a style branch: a run itself, or the jobs of a multirun in order."""
    if not folder.is_dir():
        raise UserError(f"there is no run {folder}")
    jobs = sorted((path.parent for path in folder.glob(f"*/{BRANCH}")), key=lambda path: natural(path.name))
    if not (folders := [folder] if (folder / BRANCH).is_file() else jobs):
        raise UserError(f"{folder} holds no finished training of a style branch ({BRANCH}, in it or in its jobs)")
    begun = sorted((path.parent for path in folder.glob("*/.hydra")), key=lambda path: natural(path.name))
    if folders is jobs and (left := [path.name for path in begun if path not in jobs]):
        _log.warning("jobs of %s without %s are left out: %s", folder, BRANCH, ", ".join(left))
    return folders


def trained_run(folder: Path) -> Path:
    """The one folder that holds a style branch: :func:`trained_runs` of a multirun are refused."""
    run, *more = trained_runs(folder)
    if more:
        raise UserError(f"{folder} holds {1 + len(more)} trainings; name one of them, such as {run}")
    return run


def configured(config: DictConfig, folder: Path) -> DictConfig:
    """A configuration with the parts, options and weights of a run."""
    from anystyle.io.checkpoint import read_header
    from anystyle.registry.untrusted import check_saved

    what = "record of a run, which names the weights it was trained on"
    bound: dict[str, Any] = read_json(folder / RECORD, dict[str, Any], what=what)
    saved = check_saved(read_header(folder / BRANCH).config, folder / BRANCH)
    merged = config.copy()
    with open_dict(merged):
        for part, node in saved.items():
            merged[part] = OmegaConf.create(node) if isinstance(node, dict) else node
        weights = {key.removeprefix("weights."): value for key, value in bound.items() if key.startswith("weights.")}
        merged.weights = {**weights, "branch": str(folder / BRANCH)}
    return merged
