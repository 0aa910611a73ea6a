"""Whether scores can be made again: what they rest on, compared with what is there now, and the scores themselves."""

import contextlib
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from anystyle.contracts.protocol import Evaluation
from anystyle.errors import UserError, one_line
from anystyle.evaluation import record
from anystyle.evaluation.provenance import foundations
from anystyle.io.checkpoint import sha256
from anystyle.io.record import commit, versions
from anystyle.registry.untrusted import check_saved
from anystyle.types import OnProgress
from anystyle.vision import weights
from anystyle_paper.run_table import Line

ROUNDING = 1e-5
"""Scores that differ by less than this share of their value are equal within rounding."""


@dataclass(frozen=True)
class Verification:
    """What became of scores that were to be made again.

    Args:
        name: Whose scores they are, such as the folder of an evaluation.
        scores: How many scores were compared.
        worst: The name of the one that differs most, its value before and now; ``None`` if none differs.
        changed: What it rests on that is not what it was, in words.
        failure: Why it cannot be made again.
    """

    name: str
    scores: int = 0
    worst: tuple[str, float, float] | None = None
    changed: tuple[str, ...] = ()
    failure: str = ""

    @property
    def difference(self) -> float:
        """The largest difference, as a share of the value."""
        return 0.0 if self.worst is None else _difference(*self.worst[1:])

    @property
    def holds(self) -> bool:
        """Whether the scores were made again, or what they rest on is unchanged where they were not."""
        return not self.failure and self.difference <= ROUNDING and not (self.changed and not self.scores)

    def __str__(self) -> str:
        changed = f"changed: {', '.join(self.changed)}" if self.changed else "nothing it rests on has changed"
        if self.failure:
            return f"{self.name}: cannot be made again: {self.failure}; {changed}"
        if not self.scores:  # nothing was made, or times alone
            return f"{self.name}: {changed}"
        if self.worst is None:
            return f"{self.name}: all {self.scores} scores are equal; {changed}"
        name, before, now = self.worst
        if self.holds:
            most = f"{name} by {self.difference:.1e} of its value"
            return f"{self.name}: all {self.scores} scores are equal within rounding, {most}; {changed}"
        return f"{self.name}: {name} is {now:.6g} and was {before:.6g}; {changed}"


def rests_on(provenance: Mapping[str, Any]) -> dict[str, str]:
    """The versions and hashes of a record, by what they are of."""
    found = {"code": str(provenance.get("commit", ""))}
    found |= {f"library {name}": str(value) for name, value in provenance.get("versions", {}).items()}
    found |= {f"plugin {name}": str(value) for name, value in provenance.get("plugins", {}).items()}
    found |= {f"input {name}": str(value) for name, value in provenance.get("inputs", {}).items()}
    for part, entry in provenance.get("weights", {}).items():
        files = {entry["file"]: entry["sha256"]} if "sha256" in entry else entry
        found |= {f"weights {part} ({file})": str(value) for file, value in files.items()}
    return found


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """What is not what it was, in words; code with uncommitted changes is never known to be the same."""
    pairs = {name: (before.get(name, ""), now.get(name, "")) for name in {**before, **now}}
    words = [f"{name} {_short(old)} -> {_short(new)}" for name, (old, new) in pairs.items() if old != new]
    unknown = before.get("code") == now.get("code", "") and now.get("code", "").endswith("+")
    return (*words, "code (uncommitted changes)") if unknown else tuple(words)


def _short(value: str) -> str:
    return value[:12] if len(value) > 20 else value or "missing"


def cheaply(folder: Path) -> Verification:
    """Compare what an evaluation rests on with what is there now; nothing is computed."""
    stored = _stored(folder)
    known = stored.provenance
    with _at(known):
        now = {**foundations(known["config"]), "commit": commit(), "versions": versions()}
        now["weights"] = {part: _weights_now(part, entry, known["config"]) for part, entry in known["weights"].items()}
    return Verification(str(folder), changed=changes(rests_on(known), rests_on(now)))


def _weights_now(part: str, entry: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """The hashes of the files that a part was loaded from, as they are now."""
    from anystyle.pipeline.load import weights_file

    rows = {row.file: name for name, row in weights.files().items()}

    def now(file: str) -> str:
        given = config.get("weights", {}).get(part)
        try:
            return sha256(weights_file(given) if given is not None else weights.find(rows[file]))
        except (UserError, OSError, KeyError):
            return "missing"

    if "sha256" in entry:
        return {"file": entry["file"], "sha256": now(entry["file"])}
    return {file: now(file) for file in entry}


def again(folder: Path, out: Path, on_progress: OnProgress) -> Verification:
    """Make an evaluation again in the folder ``out``, and compare all its scores but times."""
    from anystyle.evaluation.run import run

    stored = _stored(folder)
    known = stored.provenance
    config = check_saved(known["config"], folder / record.FILE)
    out = out.resolve()
    with _at(known):
        try:
            made = run(OmegaConf.create(config), out, on_progress=on_progress)
        except (UserError, OSError) as error:
            return Verification(str(folder), failure=one_line(error), changed=cheaply(folder).changed)
    before, now = _scores(stored), _scores(record.read(out) or made)
    return compared(str(folder), before, now, changes(rests_on(known), rests_on(made.provenance)))


def compared(
    name: str, before: Mapping[str, float], now: Mapping[str, float], changed: tuple[str, ...]
) -> Verification:
    """The verification of scores, each beside what it was ``before``; one that is lacking ``now`` is nan."""
    pairs = [(score, old, now.get(score, math.nan)) for score, old in before.items()]
    worst = max(
        (pair for pair in pairs if _difference(*pair[1:])), key=lambda pair: _difference(*pair[1:]), default=None
    )
    return Verification(name, len(before), worst, changed)


def _difference(before: float, now: float) -> float:
    if before == now or (math.isnan(before) and math.isnan(now)):
        return 0.0
    return math.inf if math.isnan(before) or math.isnan(now) else abs(now - before) / max(abs(before), abs(now))


def _stored(folder: Path) -> Evaluation:
    stored = record.read(folder)
    if stored is None or not {"config", "inputs", "timed"} <= stored.provenance.keys():
        raise UserError(f"{folder} holds no evaluation with its configuration and checksums of inputs; evaluate again")
    return stored


def _scores(evaluation: Evaluation) -> dict[str, float]:
    """All scores by name, of groups too, but times."""
    timed = tuple(evaluation.provenance.get("timed", []))
    groups = {"": evaluation.scores, **evaluation.groups}
    return {
        f"{name} of {group}" if group else name: value
        for group, scores in groups.items()
        for name, value in scores.items()
        if not name.startswith(timed)  # a protocol may have a score for each guide: `seconds_text`
    }


@contextlib.contextmanager
def _at(provenance: Mapping[str, Any]) -> Iterator[None]:
    """Where relative paths of a record begin, if that folder still is there."""
    folder = Path(provenance.get("folder", "."))
    with contextlib.chdir(folder if folder.is_dir() else "."):
        yield


def row_of(lines: Sequence[Line], title: str | None = None) -> Line:
    """A row of evaluations, at random unless it is named."""
    known = [line for line in lines if any(run.evaluation for run in line.runs)]
    chosen = [line for line in known if title in (None, line.title)]
    if not chosen:
        titles = ", ".join(dict.fromkeys(line.title for line in known))
        raise UserError(f"no row of evaluations is named {title!r}; there are {titles or 'none'}")
    return random.choice(chosen)
