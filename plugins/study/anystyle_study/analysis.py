"""The analysis of a study: every test at every unit, effects, variation, agreement and position bias."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import msgspec
import numpy as np
from scipy import special, stats

from anystyle.errors import UserError
from anystyle_study.answers import Records
from anystyle_study.checks import KINDS, Checks, check
from anystyle_study.contract import Alternative, Responses, Scale, StudyTest, TestResult, Unit
from anystyle_study.protocol import Rules, Study
from anystyle_study.statistics import Effect, Variation, agreement, crossed_mean, effects, holm, t_pvalue, variation


@dataclass(frozen=True)
class AnalysisOptions:
    """Options of an analysis."""

    scale: Scale = field(default_factory=Scale)  # the answer scale
    scales: Mapping[str, Scale] = field(default_factory=dict)  # scales of questions that have another one, by name
    rules: Rules = field(default_factory=Rules)  # exclusion rules
    confidence: float = 0.95  # level of all intervals; p-values up to its complement are significant
    alternative: Alternative = "two-sided"  # of all tests and intervals; ``less`` claims that ours is preferred
    seed: int = 0  # seed of all resampling
    margin: float | None = None  # of equivalence, as a fraction of the way from neutral to the end of the scale
    titles: Mapping[str, str] = field(default_factory=dict)  # texts of the questions by name, for tables and plots
    study: Study | None = None  # the design, if there is one

    def __post_init__(self) -> None:
        if not 0.5 <= self.confidence < 1:
            raise UserError(f"--confidence {self.confidence:g}: expected 0.5 to below 1, such as 0.95")
        if self.margin is not None and not 0 < self.margin < 1:
            raise UserError(f"--margin {self.margin:g}: expected a fraction of the way to the end of the scale, as 0.1")
        if self.margin is not None and self.alternative != "two-sided":
            raise UserError("--margin needs --alternative two-sided: a one-sided interval bounds one side only")


@dataclass
class NamedResult:
    """A test's result for one question."""

    name: str  # name of the test in the catalog
    result: TestResult  # its result
    pvalue_holm: float = math.nan  # after Holm's adjustment over the questions


@dataclass(frozen=True)
class Equivalence:
    """Two one-sided tests (Schuirmann 1987) on the interval of the crossed mean."""

    margin: float  # in points of the answer scale
    pvalue: float  # the larger of the two; ``nan`` if the error of the mean is unknown
    shown: bool  # whether the whole interval lies within the margin


@dataclass(frozen=True)
class Mean:
    """Mean deviation of a participant or of an item; negative prefers ours."""

    name: str  # of the participant or item
    title: str  # display name: scene and style of an item, where known
    mean: float  # over its own answers
    interval: tuple[float, float]  # of an item, over new participants; ``nan`` for a participant or without variation

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return (self.interval[1] - self.interval[0]) / 2


@dataclass(frozen=True)
class Position:
    """Preference for a side, whatever is shown there."""

    bias: float  # mean deviation as displayed; negative prefers A
    interval: tuple[float, float]  # confidence interval of the bias, over participants
    pvalue: float  # two-sided, over participants
    mean_when_ours_is_a: float  # mean deviation
    mean_when_ours_is_b: float
    half_widths: tuple[float, float]  # of the intervals of these two means


@dataclass(frozen=True)
class QuestionAnalysis:
    """All results of one question."""

    title: str
    responses: Responses
    distribution: dict[float, int]
    tests: tuple[NamedResult, ...]
    effects: tuple[Effect, ...]
    variation: Variation | None
    alpha: float
    equivalence: Equivalence | None
    position: Position | None
    by_participant: tuple[Mean, ...]
    by_item: tuple[Mean, ...]

    @property
    def primary(self) -> NamedResult | None:
        """The result to draw conclusions from: the one in points that generalises to most, participants included."""
        usable = [one for one in self.tests if one.result.estimate_unit == "points" and one.result.pvalue >= 0]
        usable = [one for one in usable if "participants" in one.result.generalizes_to]
        return max(usable, key=lambda one: len(one.result.generalizes_to), default=None)


@dataclass(frozen=True)
class Analysis:
    """The analysis of a study."""

    questions: tuple[QuestionAnalysis, ...]
    checks: Checks
    settings: AnalysisOptions
    records: Records


def analyze(
    records: Records,
    tests: Mapping[str, StudyTest],
    settings: AnalysisOptions = AnalysisOptions(),
    progress: Callable[[str], None] = lambda _: None,
) -> Analysis:
    """Check the answers and test every question."""
    checks, by_question = check(records, scale=settings.scale, rules=settings.rules, scales=settings.scales)
    questions: list[QuestionAnalysis] = []
    for responses in by_question:
        progress(responses.question)
        questions.append(_question(responses, tests, settings))
    for same in zip(*(question.tests for question in questions), strict=True):
        for one, adjusted in zip(same, holm([one.result.pvalue for one in same]), strict=True):
            one.pvalue_holm = adjusted
    return Analysis(tuple(questions), checks, settings, records)


def _question(responses: Responses, tests: Mapping[str, StudyTest], settings: AnalysisOptions) -> QuestionAnalysis:
    results = [NamedResult(name, test(responses.at(unit))) for name, test in tests.items() for unit in test.units]
    scores, counts = np.unique(responses.deviations + responses.scale.midpoint, return_counts=True)
    levels = responses.scale.levels if len(responses.scale.levels) <= 11 else ()
    given = dict.fromkeys(levels, 0) | dict(zip(scores.tolist(), counts.tolist(), strict=True))
    return QuestionAnalysis(
        title=settings.titles.get(responses.question.partition(" vs ")[0], responses.question),
        responses=responses,
        distribution=dict(sorted(given.items())),
        tests=tuple(results),
        effects=tuple(effects(responses, settings.confidence, settings.alternative)),
        variation=variation(responses),
        alpha=agreement(responses),
        equivalence=None if settings.margin is None else _equivalence(responses, settings.margin, settings.confidence),
        # A rating judges one picture: the side it was on does not enter the difference.
        position=None if responses.ratings else position_bias(responses, settings.confidence),
        by_participant=unit_means(responses, "participant", settings.confidence),
        by_item=unit_means(responses, "item", settings.confidence),
    )


def _equivalence(responses: Responses, margin: float, confidence: float) -> Equivalence:
    points = margin * (responses.scale.high - responses.scale.midpoint)
    if (crossed := crossed_mean(responses)) is None:
        return Equivalence(points, math.nan, False)
    low, high = crossed.interval(confidence)
    # The nearer margin decides: its statistic has the larger p-value.
    pvalue = t_pvalue((abs(crossed.mean) - points) / crossed.error, crossed.df, "less")
    return Equivalence(points, pvalue, -points < low and high < points)


def unit_means(responses: Responses, unit: Unit, confidence: float) -> tuple[Mean, ...]:
    """Means of all participants or items that have answers."""
    codes, names, titles = responses.items, responses.item_names, responses.item_titles
    if unit == "participant":
        codes, names = responses.participants, responses.participant_names
        titles, confidence = names, math.nan
    means = []
    for code in np.unique(codes).tolist():
        mean, half_width = _mean(responses.deviations[codes == code], confidence)
        means.append(Mean(names[code], titles[code], mean, (mean - half_width, mean + half_width)))
    return tuple(means)


def _mean(values: np.ndarray, confidence: float) -> tuple[float, float]:
    """Mean and half width of its t interval; ``nan`` where there is none."""
    n = len(values)
    error = float(values.std(ddof=1)) / math.sqrt(n) if n > 1 else 0.0
    half_width = float(special.stdtrit(n - 1, (1 + confidence) / 2)) * error if error > 0 else math.nan
    return float(values.mean()) if n else math.nan, half_width


def position_bias(responses: Responses, confidence: float) -> Position | None:
    """The preference for a side; ``None`` if ours was always on one side."""
    ours_is_a = responses.ours_is_a
    if ours_is_a is None or not 0 < ours_is_a.sum() < responses.count:
        return None
    sides = [np.full(len(responses.participant_names), np.nan) for _ in range(2)]
    for side, rows in zip(sides, (ours_is_a, ~ours_is_a), strict=True):
        for person in np.unique(responses.participants[rows]):
            side[person] = responses.deviations[rows & (responses.participants == person)].mean()
    # Half the difference between ours as A and ours as B is the bias, free of any preference for a method.
    biases = (sides[0] - sides[1]) / 2
    biases = biases[np.isfinite(biases)]
    bias, half_width = _mean(biases, confidence)
    test: Any = stats.ttest_1samp(biases, 0) if half_width > 0 else None
    pvalue = float(test.pvalue) if test else math.nan
    (as_a, as_b), half_widths = zip(*(_mean(side[np.isfinite(side)], confidence) for side in sides), strict=True)
    return Position(bias, (bias - half_width, bias + half_width), pvalue, as_a, as_b, half_widths)


def as_json(analysis: Analysis) -> dict[str, Any]:
    """The content of ``analysis.json``; ``nan`` and infinities are ``None``."""
    checks, settings, study = analysis.checks, analysis.settings, analysis.settings.study
    counts = ("participants_read", "answers_read", "attention_answers", "answers_used")
    content = {
        "schema": 2,
        "sign": "scores below the neutral answer and negative estimates mean that ours is preferred",
        "sources": analysis.records.sources,
        "settings": {
            "scale": [settings.scale.low, settings.scale.high],
            **{name: getattr(settings, name) for name in ("confidence", "alternative", "margin", "seed", "rules")},
            **({} if study is None else {"ours": study.ours, "baselines": study.baselines}),
        },
        "checks": {
            **{name: getattr(checks, name) for name in counts},
            **{kind: checks.of_kind(kind) for kind in KINDS},
            "excluded": checks.exclusions,
            "notes": checks.notes,
            "doubt": checks.doubt,
        },
        "questions": {one.responses.question: _question_json(one) for one in analysis.questions},
    }
    return msgspec.json.decode(msgspec.json.encode(content, enc_hook=lambda value: value.tolist()))


def _question_json(question: QuestionAnalysis) -> dict[str, Any]:
    responses, deviations = question.responses, question.responses.deviations
    tests = [{"name": one.name, **asdict(one.result), "pvalue_holm": one.pvalue_holm} for one in question.tests]
    return {
        **{name: getattr(question, name) for name in ("title", "effects", "variation", "equivalence", "position")},
        "n_responses": responses.count,
        "n_participants": len(question.by_participant),
        "n_items": len(question.by_item),
        "mean": deviations.mean() + responses.scale.midpoint,
        "sd": deviations.std(ddof=1) if responses.count > 1 else math.nan,
        "distribution": {f"{level:g}": count for level, count in question.distribution.items()},
        "tests": tests,
        "primary": None if question.primary is None else tests[question.tests.index(question.primary)],
        "agreement": {"name": "krippendorff_alpha_ordinal", "estimate": question.alpha},
        "ratings": responses.ratings and dict(zip(("ours", "theirs"), responses.ratings, strict=True)),
        "participants": question.by_participant,
        "items": question.by_item,
    }
