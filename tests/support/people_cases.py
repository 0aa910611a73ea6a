"""Simulated participants of a study of a benchmark's methods, for the tests and for how many of them are enough."""

import json
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

import numpy as np

from anystyle_benchmark.people import Choice
from anystyle_benchmark.results import Cell
from anystyle_study.protocol import Study

Utilities = Mapping[tuple[str, str, str], float]
"""How good a method is in a scene and style, in units of how much one person's answers vary; by all three names."""


def write_answers(study: Study, folder: Path, utilities: Mapping[str, Utilities], seed: int = 0) -> None:
    """Answers as the form saves them: a latent normal opinion, in five grades; attention checks are answered rightly.

    ``utilities`` are by question. Of two cells the difference of the utilities is seen, plus noise of SD 1.
    """
    folder.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(seed)
    for participant in study.participants:
        rows = []
        for name in participant.order:
            item, sign = study.item(name), 1 if name in participant.ours_is_a else -1
            kind = getattr(study.shown[name], "kind", "")
            for question in study.plan.questions:
                first, second = (utilities[question.name][m, item.scene, item.style] for m in study.methods(item))
                opinion = sign * (first - second) + generator.normal()
                opinion = {"degraded": 3.0 * sign, "repeat": 0.0}.get(kind, opinion)
                score = 3 - int(np.clip(np.rint(opinion / 0.6), -2, 2))
                rows.append({"item": name, "question": question.name, "side": "", "score": score, "seconds": 9.0})
        answers = {"study": study.id, "participant": participant.id, "responses": rows}
        (folder / f"answers-{participant.id}.json").write_text(json.dumps(answers))


def choices_of(votes: np.ndarray, shown: np.ndarray, *, scenes: int, styles: int) -> list[Choice]:
    """Choices of participants (rows) between the methods ``shown`` (P, N, 4: scene, style, first, second)."""
    return [
        Choice(
            f"P{person}",
            "-".join(map(str, entry)),
            (Cell(f"m{entry[2]}", 0, f"s{entry[0]}", f"t{entry[1]}"), Cell(f"m{entry[3]}", 0, f"s{entry[0]}", f"t{entry[1]}")),
            float(vote),
        )
        for person, (entries, given) in enumerate(zip(shown.tolist(), votes.tolist(), strict=True))
        for entry, vote in zip(entries, given, strict=True)
    ]
