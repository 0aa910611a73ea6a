"""From answers to findings: every test at every unit, and what a reader needs to judge them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from msgspec import structs
from scipy import special

from anystyle.study.checks import Checks, check
from anystyle.study.contract import Alternative, Responses, Scale, StudyTest, TestResult, Unit
from anystyle.study.crossed import Crossing, Variation, variation
from anystyle.study.effects import Effect, agreement, effects
from anystyle.study.probability import holm, log_t_cdf, log_t_pvalue, t_interval
from anystyle.study.protocol import Rules, Study
from anystyle.study.reading import Records


@dataclass(frozen=True)
class Settings:
    """How an analysis is made.

    Args:
        scale: Of the answers.
        scales: Of the questions that have another one, by name.
        rules: Who is left out.
        confidence: Of all intervals; a p-value up to its complement is evidence.
        alternative: Of all tests and intervals; ``less`` claims that ours is preferred.
        seed: Of all resampling.
        margin: The largest mean preference, as a share of the way from the neutral answer to the end of the scale,
            that counts as none; ``None`` asks for no equivalence.
        titles: Texts of the questions, by name, for tables and figures.
        study: The design, where there is one: its plan is told first.
    """

    scale: Scale = field(default_factory=Scale)
    scales: tuple[tuple[str, Scale], ...] = ()
    rules: Rules = field(default_factory=Rules)
    confidence: float = 0.95
    alternative: Alternative = "two-sided"
    seed: int = 0
    margin: float | None = None
    titles: tuple[tuple[str, str], ...] = ()
    study: Study | None = None

    def __post_init__(self) -> None:
        if not 0.5 <= self.confidence < 1:
            raise ValueError(f"--confidence {self.confidence:g}: expected a share from 0.5 to below 1, such as 0.95")
        if self.margin is not None and not 0 < self.margin < 1:
            raise ValueError(f"--margin {self.margin:g}: expected a share of the way to the end of the scale, as 0.1")
        if self.margin is not None and self.alternative != "two-sided":
            raise ValueError("--margin needs --alternative two-sided: a one-sided interval bounds one side alone")


@dataclass(frozen=True)
class NamedResult:
    """A test's result for one question.

    Args:
        name: The test's name in the catalog.
        result: What it found.
        log_pvalue_holm: The p-value's logarithm after Holm's adjustment over the questions.
    """

    name: str
    result: TestResult
    log_pvalue_holm: float = math.nan


@dataclass(frozen=True)
class Equivalence:
    """Two one-sided tests (Schuirmann 1987) on the interval of the crossed mean.

    Args:
        margin: In points of the answer scale.
        pvalue: The larger of the two; ``nan`` where the mean's error is not known.
        shown: Whether the whole interval lies within the margin.
    """

    margin: float
    pvalue: float
    shown: bool


@dataclass(frozen=True)
class Means:
    """Means of participants or of items, each over its own answers.

    Args:
        names: Whose.
        titles: For people: of an item its scene and style, where they are known.
        means: Deviations; negative prefers ours.
        half_width: Of an item's interval over new participants; ``nan`` for participants, whose answers share scenes
            and styles, and for one answer.
    """

    names: tuple[str, ...]
    titles: tuple[str, ...]
    means: Float[np.ndarray, " N"]
    half_width: Float[np.ndarray, " N"]


@dataclass(frozen=True)
class Position:
    """Whether answers lean to a side, whatever is shown there.

    Args:
        bias: Mean deviation as displayed; negative prefers what is shown as A.
        interval: Of the bias, over participants.
        log_pvalue: Two-sided, over participants.
        mean_as_a: Mean deviation where ours is A, and its interval's half width.
        mean_as_b: The same where ours is B.
    """

    bias: float
    interval: tuple[float, float]
    log_pvalue: float
    mean_as_a: tuple[float, float]
    mean_as_b: tuple[float, float]


@dataclass(frozen=True)
class QuestionAnalysis:
    """All that is known of one question."""

    question: str
    title: str
    responses: Responses
    levels: tuple[float, ...]
    counts: tuple[int, ...]
    tests: tuple[NamedResult, ...]
    effects: tuple[Effect, ...]
    variation: Variation | None
    alpha: float
    equivalence: Equivalence | None
    position: Position | None
    by_participant: Means
    by_item: Means

    @property
    def primary(self) -> NamedResult | None:
        """The finding to go by: of the tests of a difference in points, the first that holds for most others."""
        usable = [
            named
            for named in self.tests
            if named.result.estimate_unit == "points"
            and math.isfinite(named.result.log_pvalue)
            and "participants" in named.result.generalizes_to
        ]
        return max(usable, key=lambda named: len(named.result.generalizes_to), default=None)


@dataclass(frozen=True)
class Analysis:
    """The analysis of a study."""

    questions: tuple[QuestionAnalysis, ...]
    checks: Checks
    settings: Settings
    comments: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]


def analyze(
    records: Records,
    tests: Mapping[str, StudyTest],
    settings: Settings = Settings(),
    progress: Callable[[str], None] = lambda _: None,
) -> Analysis:
    """Check the answers and test every question.

    Raises:
        ValueError: The answers cannot be analysed.
    """
    checks, by_question = check(records, scale=settings.scale, rules=settings.rules, scales=dict(settings.scales))
    questions: list[QuestionAnalysis] = []
    for responses in by_question:
        progress(responses.question)
        questions.append(_question(responses, tests, settings))
    return Analysis(
        questions=tuple(_adjusted(questions)),
        checks=checks,
        settings=settings,
        comments=records.comments,
        sources=records.sources,
    )


def _question(responses: Responses, tests: Mapping[str, StudyTest], settings: Settings) -> QuestionAnalysis:
    results = [NamedResult(name, test(responses.at(unit))) for name, test in tests.items() for unit in test.units]
    levels, counts = _distribution(responses)
    return QuestionAnalysis(
        question=responses.question,
        title=dict(settings.titles).get(responses.question.partition(" vs ")[0], responses.question),
        responses=responses,
        levels=levels,
        counts=counts,
        tests=tuple(results),
        effects=tuple(effects(responses, settings.confidence, settings.alternative)),
        variation=variation(responses),
        alpha=agreement(responses),
        equivalence=None if settings.margin is None else _equivalence(responses, settings.margin, settings.confidence),
        # A rating is of one picture: which side it stood on is no part of the difference.
        position=None if responses.ratings else _position(responses, settings.confidence),
        by_participant=_means(responses, "participant", settings.confidence),
        by_item=_means(responses, "item", settings.confidence),
    )


def _distribution(responses: Responses) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """How often each score was given, 1 preferring ours; every level of a short scale, what occurs on a long one."""
    scores = responses.deviations + responses.scale.midpoint
    levels = np.unique(scores)
    if len(responses.scale.levels) <= 11:
        levels = np.union1d(levels, responses.scale.levels)
    counts = np.bincount(np.searchsorted(levels, scores), minlength=len(levels))
    return tuple(levels.tolist()), tuple(counts.tolist())


def _equivalence(responses: Responses, margin: float, confidence: float) -> Equivalence:
    points = margin * (responses.scale.high - responses.scale.midpoint)
    crossed = Crossing(factors=responses.factors).mean(responses.deviations) if responses.factors else None
    if crossed is None or crossed.error == 0:
        return Equivalence(points, math.nan, False)
    mean, error, df = float(crossed.mean), float(crossed.error), float(crossed.df)
    low, high = t_interval(mean, error, df, confidence, "two-sided")
    # The nearer margin decides: its statistic has the larger p-value.
    pvalue = math.exp(log_t_cdf((abs(mean) - points) / error, df))
    return Equivalence(points, pvalue, -points < low and high < points)


def _means(responses: Responses, unit: Unit, confidence: float) -> Means:
    codes = responses.participants if unit == "participant" else responses.items
    names = responses.participant_names if unit == "participant" else responses.item_names
    counts = np.bincount(codes, minlength=len(names))
    present = np.flatnonzero(counts)
    n = counts[present].astype(float)
    means = np.bincount(codes, responses.deviations, len(names))[present] / n
    half_width = np.full(len(present), np.nan)
    if unit == "item":
        squares = np.bincount(codes, responses.deviations**2, len(names))[present]
        with np.errstate(invalid="ignore", divide="ignore"):
            error = np.sqrt(np.maximum(squares - n * means**2, 0) / (n - 1) / n)
        # Where all answer alike the spread says nothing.
        half_width = np.where(error > 0, special.stdtrit(np.maximum(n - 1, 1), (1 + confidence) / 2) * error, np.nan)
    titles = responses.item_titles if unit == "item" else names
    return Means(tuple(names[i] for i in present), tuple(titles[i] for i in present), means, half_width)


def _position(responses: Responses, confidence: float) -> Position | None:
    """The position check; ``None`` where ours was always on one side."""
    ours_is_a = responses.ours_is_a
    if ours_is_a is None or not 0 < ours_is_a.sum() < responses.count:
        return None
    sides = [_by_person(responses, rows) for rows in (ours_is_a, ~ours_is_a)]
    # Ours as B turns what is displayed: the half difference is the lean to a side, free of any preference.
    both = (sides[0] - sides[1]) / 2
    biases, log_pvalue = both[np.isfinite(both)], math.nan
    bias, half_width = _mean_and_half_width(biases, confidence)
    if half_width > 0:
        statistic = bias / (half_width / float(special.stdtrit(len(biases) - 1, (1 + confidence) / 2)))
        log_pvalue = log_t_pvalue(statistic, float(len(biases) - 1), "two-sided")
    by_side = [_mean_and_half_width(side[np.isfinite(side)], confidence) for side in sides]
    return Position(bias, (bias - half_width, bias + half_width), log_pvalue, by_side[0], by_side[1])


def _by_person(responses: Responses, rows: np.ndarray) -> np.ndarray:
    size = len(responses.participant_names)
    sums = np.bincount(responses.participants[rows], responses.deviations[rows], size)
    with np.errstate(invalid="ignore"):
        return sums / np.bincount(responses.participants[rows], minlength=size)


def _mean_and_half_width(values: np.ndarray, confidence: float) -> tuple[float, float]:
    if len(values) < 2:
        return (float(values.mean()) if len(values) else math.nan), math.nan
    half_width = (
        float(special.stdtrit(len(values) - 1, (1 + confidence) / 2)) * values.std(ddof=1) / math.sqrt(len(values))
    )
    return float(values.mean()), float(half_width)


def _adjusted(questions: Sequence[QuestionAnalysis]) -> list[QuestionAnalysis]:
    """The questions with Holm's adjustment of each test over all of them."""
    adjusted = [list(question.tests) for question in questions]
    for index in range(len(adjusted[0])):
        values = holm([tests[index].result.log_pvalue for tests in adjusted])
        for tests, value in zip(adjusted, values, strict=True):
            tests[index] = NamedResult(tests[index].name, tests[index].result, value)
    return [replace(question, tests=tuple(tests)) for question, tests in zip(questions, adjusted, strict=True)]


def as_json(analysis: Analysis) -> dict[str, Any]:
    """The analysis as plain data, ``nan`` as ``None``; what ``analysis.json`` holds."""
    checks, settings = analysis.checks, analysis.settings
    kinds = ("missing", "duplicated", "out_of_range", "straight_lining", "failed_attention_check", "fast")
    content = {
        "schema": 2,
        "sign": "scores below the neutral answer and negative estimates mean that ours is preferred",
        "sources": list(analysis.sources),
        "settings": {
            "scale": [settings.scale.low, settings.scale.high],
            "confidence": settings.confidence,
            "alternative": settings.alternative,
            "margin": settings.margin,
            "seed": settings.seed,
            "rules": structs.asdict(settings.rules),
        },
        "checks": {
            "participants_read": checks.participants_read,
            "answers_read": checks.answers_read,
            "attention_answers": checks.attention_answers,
            "answers_used": checks.answers_used,
            **{kind: [asdict(item) for item in checks.findings if item.kind == kind] for kind in kinds},
            "excluded": [asdict(item) for item in checks.exclusions],
            "notes": list(checks.notes),
        },
        "questions": {question.question: _question_json(question) for question in analysis.questions},
    }
    return _finite(content)


def _question_json(question: QuestionAnalysis) -> dict[str, Any]:
    responses, position = question.responses, question.position
    return {
        "title": question.title,
        "n_responses": responses.count,
        "n_participants": len(question.by_participant.names),
        "n_items": len(question.by_item.names),
        "mean": float(responses.deviations.mean()) + responses.scale.midpoint,
        "sd": float(responses.deviations.std(ddof=1)) if responses.count > 1 else math.nan,
        "distribution": {f"{level:g}": count for level, count in zip(question.levels, question.counts, strict=True)},
        "tests": [_row_json(named) for named in question.tests],
        "effects": [asdict(effect) for effect in question.effects],
        "variation": None if question.variation is None else asdict(question.variation),
        "agreement": {"name": "krippendorff_alpha_ordinal", "estimate": question.alpha},
        "equivalence": None if question.equivalence is None else asdict(question.equivalence),
        "ratings": None if responses.ratings is None else dict(zip(("ours", "theirs"), responses.ratings, strict=True)),
        "position": None
        if position is None
        else {
            "bias": position.bias,
            "interval": position.interval,
            "pvalue": math.exp(position.log_pvalue),
            "mean_when_ours_is_a": position.mean_as_a[0],
            "mean_when_ours_is_b": position.mean_as_b[0],
        },
        "participants": _means_json(question.by_participant),
        "items": _means_json(question.by_item),
    }


def _row_json(named: NamedResult) -> dict[str, Any]:
    """One row of a question's ``tests``."""
    result = asdict(named.result)
    del result["log_pvalue"]
    return {
        "name": named.name,
        **result,
        "pvalue": named.result.pvalue,
        "log10_pvalue": named.result.log10_pvalue,
        "pvalue_holm": math.exp(named.log_pvalue_holm),
    }


def _means_json(means: Means) -> list[dict[str, Any]]:
    rows = zip(means.names, means.means.tolist(), means.half_width.tolist(), strict=True)
    return [
        {"name": name, "mean": mean, "interval": [mean - half_width, mean + half_width]}
        for name, mean, half_width in rows
    ]


def _finite(value: Any) -> Any:
    """Plain data without ``nan`` or infinities, which JSON has no words for."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
