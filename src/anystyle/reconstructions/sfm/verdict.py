"""Which of several models to take, which of its views, and how far it can be trusted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Int

from anystyle.io.names import natural
from anystyle.reconstructions.sfm.matches import VerifiedPair
from anystyle.reconstructions.sfm.model import SparseModel, triangulation_angles
from anystyle.reconstructions.sfm.support import Agreement, agreement, share_of_rotation, supported_views

LEAST_SUPPORT = 30
"""Points that hold a view in its place."""
MOST_ROTATION, MOST_POSITION = 2.0, 0.1
"""How far the mappers may differ on a view: in degrees, and as a share of the cameras' spread."""
LEAST_ANGLE = 1.5
"""Degrees of parallax, in the median of points, under which depth is a guess."""
FEWEST_VIEWS = 3
FEWEST_FEATURES = 60
"""Features of a photograph, in the median, under which there is too little to see."""
TURNED = 0.7
"""Share of matches explained by turns alone from which on a camera is said to turn without moving."""

Trust = Literal["good", "doubtful", "failed"]


@dataclass(frozen=True)
class Verdict:
    """How far cameras can be trusted.

    Args:
        trust: ``good``: two independent mappers agree on the cameras. ``doubtful``: there are cameras, and the reasons
            say what speaks against them. ``failed``: there are none.
        reasons: Plain sentences; what was left out and what to do, too.
        measures: What was measured, by name.
    """

    trust: Trust
    reasons: tuple[str, ...]
    measures: Mapping[str, float]

    def report(self) -> dict[str, object]:
        """What a report says of the cameras."""
        return {"trust": self.trust, "reasons": list(self.reasons)}


class Capture(NamedTuple):
    """What is known of photographs before they are mapped.

    Args:
        names: Of the photographs.
        num_features: Of each.
        sizes: Height and width of what features were sought in, of each.
        pairs: With matches that a rigid scene explains.
    """

    names: Sequence[str]
    num_features: Sequence[int]
    sizes: Sequence[tuple[int, int]]
    pairs: Sequence[VerifiedPair]


class Judged(NamedTuple):
    """The model that is taken, with the views that it is trusted for; ``None`` if there is none."""

    model: SparseModel | None
    verdict: Verdict


def judge(capture: Capture, candidates: Sequence[Sequence[SparseModel]]) -> Judged:
    """Choose among the models of several mappers.

    Of every mapper's models views are kept that enough points hold in their places. The model with most such views is
    taken, then the one with most points. Views on which the best model of another mapper differs are left out if
    others remain, and a model that nothing confirms is doubtful.

    Args:
        capture: What is known of the photographs.
        candidates: Models of each mapper.
    """
    turned = share_of_rotation(capture.pairs, capture.sizes) if capture.pairs else 0.0
    held = [best for models in candidates if (best := _best(models)) is not None]
    held.sort(key=_rank, reverse=True)
    if not held:
        return _nothing(capture, turned)
    compared = _compare(held[0], held[1]) if len(held) > 1 else None
    doubts, views, measures = _doubts(capture, compared, np.flatnonzero(held[0].registered))
    model = held[0].restricted(views)
    parallax = float(np.median(triangulation_angles(model)))
    if parallax < LEAST_ANGLE:
        doubts.append(
            f"the rays to a point differ by {parallax:.1f}° in the median, so depth is uncertain; "
            "move further sideways between photographs"
        )
    if doubts and turned >= TURNED:
        return _nothing(capture, turned)
    counts = {"registered": float(len(views)), "points": float(len(model.points))}
    measures |= counts | {"parallax_degrees": parallax, "turned": turned}
    reasons = (*doubts, *_left_out(capture, held[0]))
    return Judged(model, Verdict("doubtful" if doubts else "good", reasons, measures))


def _nothing(capture: Capture, turned: float) -> Judged:
    measures = {"registered": 0.0, "turned": turned}
    return Judged(None, Verdict("failed", (_why_nothing(capture, turned),), measures))


def _why_nothing(capture: Capture, turned: float) -> str:
    """Why photographs gave no cameras, and what to do."""
    count, features = len(capture.names), float(np.median(capture.num_features))
    if count == 1:
        return "one photograph shows no depth; take at least three, with a step sideways between them"
    if features < FEWEST_FEATURES:
        return (
            f"there is too little to see in the photographs ({features:.0f} points each in the median): "
            "a blank surface, darkness or blur; show textured things, in focus"
        )
    group = overlapping_groups(count, capture.pairs)[0]
    if len(group) < min(count, FEWEST_VIEWS):
        which = "no two of them show" if len(group) == 1 else f"only {_listed(capture, group)} show"
        return (
            f"the photographs do not overlap: {which} the same things; "
            "neighbouring photographs should share at least two thirds of what they show"
        )
    if count < FEWEST_VIEWS:
        return f"{count} photographs overlap, and at least {FEWEST_VIEWS} are needed to find where cameras were"
    if turned >= TURNED:
        return "the camera turned without moving, which shows no depth; take a step sideways between photographs"
    return (
        "the photographs share too little for a model of three of them; take more of them, with smaller steps between"
    )


def overlapping_groups(count: int, pairs: Sequence[VerifiedPair]) -> list[list[int]]:
    """Photographs connected by pairs with matches, the largest group first."""
    group = list(range(count))
    for pair in pairs:
        old, new = group[pair.second], group[pair.first]
        group = [new if one == old else one for one in group]
    return sorted(([view for view in range(count) if group[view] == one] for one in set(group)), key=len, reverse=True)


def _best(models: Sequence[SparseModel]) -> SparseModel | None:
    """The models' views that are held in place, of the model with most of them."""
    held = [model.restricted(supported_views(model.seen(), LEAST_SUPPORT)) for model in models]
    held = [model for model in held if model.num_registered >= FEWEST_VIEWS]
    return max(held, key=_rank, default=None)


def _rank(model: SparseModel) -> tuple[int, int]:
    return model.num_registered, len(model.points)


class _Compared(NamedTuple):
    views: Int[np.ndarray, " C"]
    difference: Agreement


def _compare(first: SparseModel, second: SparseModel) -> _Compared | None:
    common = np.flatnonzero(first.registered & second.registered)
    if len(common) < FEWEST_VIEWS:
        return None
    return _Compared(common, agreement(second.world_from_camera[common], first.world_from_camera[common]))


def _doubts(
    capture: Capture, compared: _Compared | None, views: Int[np.ndarray, " S"]
) -> tuple[list[str], Int[np.ndarray, " R"], dict[str, float]]:
    """What speaks against a model, which of its views remain, and what was measured."""
    if compared is None:
        return ["only one of two methods found these cameras, and nothing confirms them"], views, {}
    rotation, position = compared.difference
    measures = {"mappers_rotation_degrees": float(rotation.max()), "mappers_position": float(position.max())}
    agreed = compared.difference.within(MOST_ROTATION, MOST_POSITION)
    if agreed.all():
        return [], views, measures
    wrong = compared.views[~agreed]
    doubt = (
        f"two methods disagree on the cameras of {_listed(capture, wrong)} (by up to {rotation.max():.1f}° and "
        f"{100 * position.max():.0f} % of the path's size); take photographs between these and their neighbours"
    )
    remaining = np.setdiff1d(views, wrong)
    if agreed.sum() < max(FEWEST_VIEWS, len(agreed) / 2):
        return [doubt], views, measures
    return [doubt], remaining, measures


def _left_out(capture: Capture, model: SparseModel) -> list[str]:
    """Sentences about photographs without a camera."""
    missing = [int(view) for view in np.flatnonzero(~model.registered)]
    linked = {view for pair in capture.pairs for view in (pair.first, pair.second)}
    alone = [view for view in missing if view not in linked]
    weak = [view for view in missing if view in linked]
    reasons = []
    if alone:
        reasons.append(f"{_listed(capture, alone)} shares nothing with any other photograph and was left out")
    if weak:
        reasons.append(
            f"{_listed(capture, weak)} shares too little with the others and was left out; "
            "take photographs between it and its neighbours"
        )
    return reasons


def _listed(capture: Capture, views: Sequence[int] | Int[np.ndarray, " S"], most: int = 6) -> str:
    names = sorted((capture.names[view] for view in views), key=natural)
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
