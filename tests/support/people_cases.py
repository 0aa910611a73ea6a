"""Simulated participants of a study of a benchmark's methods, for the tests and for how many of them are enough."""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from anystyle_benchmark.people import Choice
from anystyle_benchmark.results import Cell
from anystyle_study.protocol import Study

Utilities = Mapping[tuple[str, str, str], float]
"""How good a method is in a scene and style, in standard deviations of one person's answers; by all three names."""


def crossing(participants: int, scenes: int, styles: int, methods: int = 4, seed: int = 0) -> np.ndarray:
    """A design (P, N, 4): each participant sees two random methods in each scene and style; scene, style, and both."""
    cells = np.tile(np.indices((scenes, styles)).reshape(2, -1).T, (participants, 1, 1))
    pairs = np.random.default_rng(seed).random((*cells.shape[:2], methods)).argsort(-1)[..., :2]
    return np.concatenate([cells, pairs], axis=-1)


def simulated(
    design: np.ndarray, noise: float, seed: int, *, shared: float = 0.0
) -> tuple[list[Choice], np.ndarray, float]:
    """Answers to the pairs of a design; a score's order of them; and how differences of both correlate.

    Utilities are standard normal for each method, scene and style, and another time for each method and scene by the
    SD ``shared``. The score is the utility and ``noise`` times utilities of its own, or these alone if it is infinite.
    People see the utility, a taste for each method of SD 0.5, and noise of SD 1 in the difference of two.
    """
    generator = np.random.default_rng(seed)
    scenes, styles, methods = (int(design[..., of].max()) + 1 for of in ((0,), (1,), (2, 3)))

    def utilities() -> np.ndarray:
        shape = scenes, styles, methods
        return generator.normal(size=shape) + shared * generator.normal(size=(scenes, 1, methods))

    truth, own = utilities(), utilities()
    score = own if math.isinf(noise) else truth + noise * own
    scene, style, first, second = np.moveaxis(design, -1, 0)
    person = np.broadcast_to(np.arange(len(design))[:, None], scene.shape)
    taste = generator.normal(0, 0.5, (len(design), methods))
    seen = truth[scene, style, first] - truth[scene, style, second] + taste[person, first] - taste[person, second]
    votes = np.sign(seen + generator.normal(size=seen.shape))
    order = np.sign(score[scene, style, first] - score[scene, style, second])
    choices = [
        Choice(
            f"P{p}", f"{s}-{t}-{a}-{b}", (Cell(f"m{a}", 0, f"s{s}", f"t{t}"), Cell(f"m{b}", 0, f"s{s}", f"t{t}")), vote
        )
        for p, (rows, given) in enumerate(zip(design.tolist(), votes.tolist(), strict=True))
        for (s, t, a, b), vote in zip(rows, given, strict=True)
    ]
    gap = 2 * (1 + shared**2)
    return choices, order.ravel(), gap / math.sqrt((gap + 2 * 0.5**2 + 1) * gap * (1 + noise**2))


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
