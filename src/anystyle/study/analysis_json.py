"""The analysis as plain data: what ``analysis.json`` holds."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from msgspec import structs

from anystyle.study.analysis import Analysis, Means, NamedResult, QuestionAnalysis


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
