"""Folders of runs: evaluations, trainings, the jobs of a multirun, and the state of each."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

from anystyle.contracts.protocol import Evaluation
from anystyle.errors import UserError
from anystyle.evaluation import record
from anystyle.io.checkpoint import sha256
from anystyle.io.documents import as_number, kept_json, read_yaml
from anystyle.paths import natural
from anystyle.registry.jobs import swept

_log = logging.getLogger(__name__)
OVERRIDES = Path(".hydra") / "overrides.yaml"

RunState = Literal["finished", "unfinished", "failed", "missing"]


@dataclass(frozen=True)
class Run:
    """One job, or one evaluation, with its overrides; a job of a multirun that left no folder is ``missing``."""

    folder: Path
    words: tuple[str, ...]
    state: RunState
    evaluation: Path | None = None
    logged: Mapping[str, float] = field(default_factory=dict)

    def record(self) -> Evaluation:
        """Its scores: those of its evaluation, or else what it logged."""
        stored = None if self.evaluation is None else record.read(self.evaluation)
        return stored or Evaluation(self.logged, n=0)


def find(folder: Path) -> list[Run]:
    """The runs in a folder, in order: itself, the jobs of a multirun, or the runs in its sub-folders."""
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}; name a run, a multirun or an evaluation")
    runs = [_run(folder)] if _is_run(folder) else list(_inside(folder))
    if not runs:
        expected = "an evaluation (metrics.json), a training, or a multirun with its jobs"
        raise UserError(f"{folder} holds no runs; expected {expected}")
    return sorted(runs, key=lambda run: (run.folder.parent.as_posix(), natural(run.folder.name)))


def _inside(folder: Path) -> Iterator[Run]:
    folders = [path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")]
    lists = swept(folder)
    jobs = {str(number): words for number, words in enumerate(product(*lists) if lists else ())}
    known = {path.name: _run(path) for path in folders if _is_run(path)}
    # What a job wrote itself counts: the list of jobs is that of the last command in this folder.
    known = {name: replace(run, words=run.words or jobs.get(name, ())) for name, run in known.items()}
    # Jobs whose folders are named by their words, which may have a / in them, lie deeper.
    deeper = [run for path in folders if path.name not in known and "=" in path.name for run in _inside(path)]
    by_words = [*deeper, *(run for name, run in known.items() if "=" in name)]
    varied = {word for values in lists if len(values) > 1 for word in values}
    for name, words in jobs.items():
        elsewhere = [*known.values(), *deeper] if name in known else by_words
        if not any(varied & set(words) <= set(run.words) for run in elsewhere):
            left_nothing = name in known or not (folder / name).is_dir()
            yield Run(folder / name, words, "missing" if left_nothing else "failed")
    yield from known.values()
    yield from deeper
    if not known and not jobs:
        for path in folders:
            yield from _inside(path) if "=" not in path.name else ()


def _is_run(folder: Path) -> bool:
    if (folder / record.FILE).is_file() or (folder / OVERRIDES).is_file():
        return True
    return len(list(folder.glob(f"*/{record.FILE}"))) == 1 and bool(_evaluation(folder))


def _run(folder: Path) -> Run:
    try:
        words = tuple(read_yaml(folder / OVERRIDES, list[str], what="list of overrides"))
    except UserError:
        words = ()
    stored: dict[str, Any] | None = kept_json(folder / record.FILE, dict[str, Any])
    numbers = {name: value for name, value in (stored or {}).items() if value is None or type(value) in (int, float)}
    logged = {} if "provenance" in (stored or {}) else {name: as_number(value) for name, value in numbers.items()}
    if (folder / "last.ckpt").is_file() and stored is None:  # also where an earlier training left weights
        return Run(folder, words, "unfinished")
    evaluation = _evaluation(folder)
    finished = evaluation or logged or any(folder.glob("*.safetensors"))
    return Run(folder, words, "finished" if finished else "failed", evaluation, logged)


def _evaluation(folder: Path) -> Path | None:
    inside = sorted(path.parent for path in folder.glob(f"*/{record.FILE}"))
    for path in dict.fromkeys((folder, folder / "evaluation", *inside)):
        if (found := record.read(path)) is not None:
            if path == folder or _is_of(folder, found.provenance.get("weights")):
                return path
            _log.warning("%s judged other weights than %s has now: evaluate it again", path, folder)
    return None


def _is_of(run: Path, judged: object) -> bool:
    """Whether what was judged are the weights that a training has now, as far as it is known."""
    rows: Mapping[str, Any] = judged if isinstance(judged, dict) else {}
    digests = {part: row["sha256"] for part, row in rows.items() if isinstance(row, dict) and "sha256" in row}
    files = {part: run / f"{part}.safetensors" for part in digests}
    return all(sha256(file) == digests[part] for part, file in files.items() if file.is_file())
