"""How often each printed claim errs: ``python plugins/study/tests/calibration.py`` prints the table of
``docs/notes/2026-11-user-study.md``.

Every claim is simulated for what it says: a factor that it speaks of is drawn anew in every study; the effects of the
others are drawn too and then centred, so that they are "these". False positives come from studies without a preference,
coverage from studies with one, whose true value is a closed form. Results are kept in ``calibration.json`` beside this
file, design by design: run again, it goes on where it stopped; delete an entry to have it simulated again.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import special

from anystyle_study.analysis import position_bias, unit_means
from anystyle_study.contract import Responses
from anystyle_study.crossed import Crossing
from anystyle_study.power import Scenario, table
from anystyle_study.significance.one_sample_t import OneSampleT
from anystyle_study.significance.ordinal_mixed import OrdinalMixed
from anystyle_study.significance.sign_flip import SignFlip
from anystyle_study.significance.wilcoxon import Wilcoxon

FILE = Path(__file__).with_name("calibration.json")
PAGE = Path(__file__).parents[3] / "docs" / "notes" / "2026-11-user-study.md"
SHARED = {"participant_sd": 0.5, "item_sd": 0.2, "scene_sd": 0.3, "style_sd": 0.3}
DESIGNS = {
    "small": Scenario(participants=10, items=12, scenes=4, styles=3, **SHARED),
    "crossed": Scenario(participants=40, items=20, scenes=5, styles=4, **SHARED),
    "large": Scenario(participants=100, items=40, scenes=8, styles=5, **SHARED),
    "incomplete": Scenario(participants=60, items=12, pool=60, scenes=12, styles=6, **SHARED),
    "alike": Scenario(participants=40, items=20, scenes=5, styles=4, scene_sd=0.0, style_sd=0.0),
}
WORDS = {
    "small": "10 people, 12 sets (4 x 3)",
    "crossed": "40 people, 20 sets (5 x 4)",
    "large": "100 people, 40 sets (8 x 5)",
    "incomplete": "60 people, 12 each of 60 sets (12 x 6)",
    "alike": "as crossed, scenes and styles alike",
}
EFFECT = -0.5
REPLICATIONS = {"crossed": 5000, "looped": 2000, "ordinal": 300}
_LEVELS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])


def probabilities(center: np.ndarray | float, sd: float) -> np.ndarray:
    """How often each answer is given by opinions of a normal distribution."""
    edges = special.ndtr((np.array([-1.5, -0.5, 0.5, 1.5]) - np.asarray(center)[..., None]) / sd)
    padded = np.concatenate([np.zeros_like(edges[..., :1]), edges, np.ones_like(edges[..., :1])], axis=-1)
    return np.diff(padded, axis=-1)


def studies(
    scenario: Scenario, these: Sequence[str], effect: float, count: int, seed: int, logits: bool = False
) -> Iterator[tuple[Responses, float]]:
    """Studies, and the true mean for new levels of every factor but ``these``; ``logits`` makes the noise logistic."""
    drawn, generator = table(scenario, seed), np.random.default_rng((seed, count))
    levels = {"participants": drawn.participants, "items": drawn.items}
    for factor, names in (("scenes", drawn.item_scenes), ("styles", drawn.item_styles)):
        levels[factor] = np.unique(names, return_inverse=True)[1][drawn.items]
    spread = math.hypot(scenario.residual_sd, *(sd for factor, sd in scenario.sds.items() if factor not in these))
    for _ in range(count):
        fixed, free = np.full(drawn.count, effect), np.zeros(drawn.count)
        for factor, sd in scenario.sds.items():
            of = generator.normal(0, sd, levels[factor].max() + 1)[levels[factor]]
            if factor in these:
                fixed += of - of.mean()
            else:
                free += of
        noise = (
            generator.logistic(size=drawn.count) if logits else generator.normal(0, scenario.residual_sd, drawn.count)
        )
        opinion = fixed + free + noise
        answers = np.searchsorted([-2, -0.7, 0.7, 2], opinion) - 2.0 if logits else np.clip(np.rint(opinion), -2, 2)
        yield replace(drawn, deviations=answers), float((probabilities(fixed, spread) @ _LEVELS).mean())


class Counts(dict):
    """For each claim: errors without a preference, their studies, hits of the truth, their studies."""

    def add(self, claim: str, effect: float, rejected: float, covered: float, weight: int = 1) -> None:
        row = self.setdefault(claim, [0, 0, 0, 0])
        values = (rejected, weight, 0, 0) if effect == 0 else (0, 0, covered, weight)
        self[claim] = [old + float(new) for old, new in zip(row, values, strict=True)]


def _crossed(scenario: Scenario, counts: Counts) -> None:
    """What rests on the crossed mean, all studies at once."""
    for these, claim in (((), "crossed t"), (("scenes", "styles"), "crossed t, scenes and styles not told")):
        for seed, effect in enumerate((0.0, EFFECT)):
            drawn = list(studies(scenario, these, effect, REPLICATIONS["crossed"], seed))
            values, truths = np.array([one.deviations for one, _ in drawn]).T, np.array([truth for _, truth in drawn])
            first = drawn[0][0]
            first = replace(first, item_scenes=(), item_styles=()) if these else first
            crossing, weight = Crossing(factors=first.factors), values.shape[1]
            _batch(counts, claim, crossing, values, truths, effect)
            if these:
                continue
            _batch(counts, "probability of superiority", crossing, (1 - np.sign(values)) / 2 - 0.5,
                   _superiority(scenario, effect), effect)  # fmt: skip
            mean, sd = values.mean(0), values.std(0, ddof=1)
            standard = (values - mean) / sd
            found = crossing.mean(standard - mean / sd * (standard**2 - 1) / 2)
            reach = special.stdtrit(found.df, 0.975) * found.error
            chance = probabilities(effect, _spread(scenario)) @ np.stack([_LEVELS, _LEVELS**2], axis=1)
            truth = chance[0] / math.sqrt(chance[1] - chance[0] ** 2)
            missed = np.abs(mean / sd - truth) > reach
            counts.add("Cohen's d", effect, (np.abs(mean / sd) > reach).sum(), (~missed).sum(), weight)
            if effect:
                # The margin is the truth: to call that comparable is the error.
                found = crossing.mean(values)
                reach = special.stdtrit(found.df, 0.975) * found.error
                wrong = np.abs(found.mean) + reach < abs(truths)
                counts.add("comparable within a margin", 0.0, wrong.sum(), 0, weight)


def _batch(
    counts: Counts, claim: str, crossing: Crossing, values: np.ndarray, truth: np.ndarray, effect: float
) -> None:
    found = crossing.mean(values)
    reach = special.stdtrit(found.df, 0.975) * found.error
    covered = np.abs(found.mean - truth) <= reach
    counts.add(claim, effect, (np.abs(found.mean) > reach).sum(), covered.sum(), values.shape[1])


def _spread(scenario: Scenario) -> float:
    return math.hypot(scenario.residual_sd, *scenario.sds.values())


def _superiority(scenario: Scenario, effect: float) -> float:
    chance = probabilities(effect, _spread(scenario))
    return float(chance[:2].sum() + chance[2] / 2 - 0.5)


def _looped(scenario: Scenario, counts: Counts) -> None:
    """What counts one mean a participant, or one a set."""
    by_participant = {"one sample t": OneSampleT(), "wilcoxon": Wilcoxon(), "sign flip": SignFlip(resamples=999)}
    for unit, these, tests in (
        ("participant", ("items", "scenes", "styles"), by_participant),
        ("item", ("participants", "scenes", "styles"), {"one sample t": OneSampleT(), "wilcoxon": Wilcoxon()}),
    ):
        for seed, effect in enumerate((0.0, EFFECT)):
            for one, truth in studies(scenario, these, effect, REPLICATIONS["looped"], seed + 10):
                rows = one.at(unit)
                for name, test in tests.items():
                    result = test(rows)
                    low, high = result.interval
                    counts.add(f"{name}, {unit}s", effect, result.pvalue <= 0.05, low <= truth <= high)
                if unit == "participant" and effect == 0:
                    position = position_bias(one, 0.95)
                    counts.add("lean to a side", 0.0, position.pvalue <= 0.05, 0)
                    counts.add("lean to a side", 1.0, 0, position.interval[0] <= 0 <= position.interval[1])


def _sets(scenario: Scenario, counts: Counts) -> None:
    """A single set's mean, over new participants: its truth is known where its effect is drawn."""
    drawn, generator = table(scenario, 0), np.random.default_rng(20)
    people = scenario.participants * scenario.items // scenario.sets
    spread = math.hypot(scenario.residual_sd, scenario.participant_sd)
    for _ in range(REPLICATIONS["looped"]):
        center = generator.normal(EFFECT, math.hypot(scenario.item_sd, scenario.scene_sd, scenario.style_sd))
        answers = np.clip(np.rint(generator.normal(center, spread, people)), -2, 2)
        zeros = np.zeros(people, dtype=int)
        one = replace(drawn, deviations=answers, participants=np.arange(people), items=zeros, ours_is_a=None)
        (mean,), truth = unit_means(one, "item", 0.95), float(probabilities(center, spread) @ _LEVELS)
        counts.add("mean of a set", EFFECT, 0, not abs(mean.mean - truth) > mean.half_width)


def _ordinal(scenario: Scenario, counts: Counts) -> None:
    """The latent preference, of answers that the model describes: logistic noise."""
    scaled = {name: 1.6 * getattr(scenario, name) for name in ("participant_sd", "item_sd", "scene_sd", "style_sd")}
    latent = replace(scenario, **scaled)
    count = min(REPLICATIONS["ordinal"], 400_000 // (scenario.participants * scenario.items))
    for seed, effect in enumerate((0.0, EFFECT)):
        for one, _ in studies(latent, (), effect, count, seed + 30, logits=True):
            result = OrdinalMixed()(one)
            counts.add(
                "ordinal mixed", effect, result.pvalue <= 0.05, result.interval[0] <= effect <= result.interval[1]
            )


GROUPS = {"crossed": _crossed, "sets": _sets, "looped": _looped, "ordinal": _ordinal}


def markdown(results: dict) -> str:
    """The table: false positives and coverage of every claim on every design."""
    lines = ["| claim | " + " | ".join(WORDS[name] for name in DESIGNS) + " | studies |"]
    lines.append("|---|" + "---:|" * (len(DESIGNS) + 1))
    claims = dict.fromkeys(claim for groups in results.values() for rows in groups.values() for claim in rows)
    for claim in claims:
        cells, most = [], 0.0
        for name in DESIGNS:
            row = next((rows[claim] for rows in results.get(name, {}).values() if claim in rows), None)
            wrong, studies_null, hits, studies_true = row or (0, 0, 0, 0)
            most = max(most, studies_null, studies_true)
            error = f"{wrong / studies_null:.3f}" if studies_null else "–"
            cells.append(f"{error} / {hits / studies_true:.3f}" if studies_true else f"{error} / –")
        lines.append(f"| {claim} | " + " | ".join(cells) + f" | {most:.0f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Simulate what is missing, and print the table."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--design", action="append", choices=DESIGNS, help="only these")
    words.add_argument("--group", action="append", choices=GROUPS, help="only these claims")
    arguments = words.parse_args()
    results = json.loads(FILE.read_text()) if FILE.exists() else {}
    for group in arguments.group or GROUPS:
        for name in arguments.design or DESIGNS:
            if group in results.setdefault(name, {}):
                continue
            counts = Counts()
            GROUPS[group](DESIGNS[name], counts)
            results[name][group] = dict(counts)
            FILE.write_text(json.dumps(results, indent=1) + "\n")
    sys.stdout.write(markdown(results))


if __name__ == "__main__":
    main()
