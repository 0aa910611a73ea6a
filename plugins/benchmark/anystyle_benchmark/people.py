"""How far a benchmark's figures order methods as people do, by a study of pairs of its images.

Of the answered pairs in which a participant prefers one side, a figure prefers the same side, the other, or neither.
The first share minus the second is Somers' D of the figure given the answers (American Sociological Review 1962):
Kendall's tau of the two orders of the methods of a scene and style, over the pairs that were shown, where neither has
ties. An answer without a preference has no order to agree with and is counted apart; a tie of the figure counts as
neither. ``(1 + D) / 2`` is the share of pairs in which the figure agrees, ties half.

The interval and the p-value are those of the user study's model, for new participants, scenes and styles, crossed, and
for these methods (:func:`anystyle_study.statistics.crossed_mean`); what one scene and style has of its own is a factor,
too, since its sets share images. D without each of the methods says how much hangs on one of them.
"""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from msgspec import Struct
from msgspec.structs import replace

from anystyle.errors import UserError
from anystyle.io.documents import Figure, as_figure, as_number, read_json
from anystyle_benchmark.ladder import compared
from anystyle_benchmark.results import Cell, CellFigures, Figures, Lock, MetricInfo
from anystyle_benchmark.statistics import CONFIDENCE, rounded
from anystyle_study.checks import Checks, check
from anystyle_study.contract import Population, Responses, Scale
from anystyle_study.protocol import read_study
from anystyle_study.reading import read_responses
from anystyle_study.statistics import crossed_mean, holm, t_pvalue

IMAGES = "images.json"
"""The file of a study with the hashes of the benchmark's images that it shows, by ``METHOD/SEED/SCENE/STYLE``."""
OTHERS = "other participants"
"""In place of a figure: what the majority of the other participants prefers in the same set."""


class Choice(NamedTuple):
    """An answer to a set of two cells of a scene and style: 1 prefers the first, -1 the second, 0 neither."""

    participant: str
    item: str
    cells: tuple[Cell, Cell]
    vote: float

    @property
    def place(self) -> str:
        """Scene and style."""
        return "/".join(self.cells[0][2:])


class RankCorrelation(Struct, frozen=True, kw_only=True):
    """Somers' D of a figure given the answers to a question.

    Args:
        d: From -1 to 1.
        low, high: Its 95 % interval; ``None``, as the p-value, where nothing varies.
        holm: The two-sided ``pvalue``, adjusted over all figures of the question; ``None`` also where too few people
            are left for a conclusion.
        agrees: The share of pairs in which the figure prefers what the participant does, ties half.
        without: The least and the greatest D if one of the methods is left out.
        pairs: How many answers have a preference; ``undecided`` have none, ``ties`` of the pairs tie by the figure.
        generalizes_to: What the interval is for.
    """

    question: str
    figure: str
    d: Figure
    low: Figure
    high: Figure
    pvalue: Figure
    holm: Figure = None
    agrees: Figure
    without: tuple[Figure, Figure]
    pairs: int
    undecided: int
    ties: int
    participants: int
    scenes: int
    styles: int
    generalizes_to: tuple[Population, ...]


class People(Struct, frozen=True):
    """How far a track's figures agree with a study's participants, and these with each other.

    ``others`` has a row for each question, of what the majority of the other participants prefers; ``notes`` say what
    was left out.
    """

    track: Lock
    study: str
    methods: list[str]
    metrics: dict[str, MetricInfo]
    figures: list[RankCorrelation]
    others: list[RankCorrelation]
    notes: list[str]


def named(cell: Cell) -> str:
    """``METHOD/SEED/SCENE/STYLE``."""
    return "/".join(map(str, cell))


def answers_in(folder: Path) -> Path:
    """The answers beside a study: ``answers.sqlite``, or a folder ``answers``."""
    found = next((path for path in (folder / "answers.sqlite", folder / "answers") if path.exists()), None)
    if found is None:
        raise UserError(f"the study {folder} has no answers beside it (answers.sqlite, or a folder answers)")
    return found


def read_choices(folder: Path) -> tuple[str, dict[str, list[Choice]], Checks]:
    """A study's id, its answers by question (those of excluded participants left out), and what was checked."""
    study = read_study(folder)
    scales = {question.name: question.scale for question in study.plan.questions}
    records = read_responses([answers_in(folder)], study)
    checks, parts = check(records, scale=Scale(), rules=study.plan.rules, scales=scales)
    choices: dict[str, list[Choice]] = {}
    for part in parts:
        for person, item, deviation in zip(part.participants, part.items, part.deviations, strict=True):
            shown = study.item(part.item_names[item])
            first, second = (Cell(method, 0, shown.scene, shown.style) for method in study.methods(shown))
            choice = Choice(part.participant_names[person], shown.id, (first, second), -float(np.sign(deviation)))
            choices.setdefault(part.question.partition(" vs ")[0], []).append(choice)
    return study.id, choices, checks


def correlated(figures: Figures, folder: Path) -> People:
    """The rank correlations of all figures with the answers of the study in a folder."""
    study, answered, checks = read_choices(folder)
    notes = [f"{one.participant} is excluded ({one.rule})." for one in checks.exclusions]
    hashes: dict[str, str] = {}
    if (folder / IMAGES).is_file():
        hashes = read_json(folder / IMAGES, dict[str, str], what="record of a study's images")
    else:
        notes.append(f"There is no {IMAGES}: whether the images that people saw are those judged is not known.")
    judged = {cell.cell: cell for cell in figures.cells}
    reasons = {
        cell: _lost(cell, figures, hashes.get(named(cell), ""), judged.get(cell))
        for cell in {cell for choices in answered.values() for choice in choices for cell in choice.cells}
    }

    def reason(choice: Choice) -> str:
        return next(filter(None, map(reasons.__getitem__, choice.cells)), "")

    lost = Counter(filter(None, (reason(choice) for choices in answered.values() for choice in choices)))
    answered = {name: [choice for choice in choices if not reason(choice)] for name, choices in answered.items()}
    answered = {name: choices for name, choices in answered.items() if choices}
    for name, choices in answered.items():
        people, places = {choice.participant for choice in choices}, {choice.cells[0][2:] for choice in choices}
        prefer = sum(choice.vote != 0 for choice in choices)
        scenes, styles = map(len, map(set, zip(*places, strict=True)))
        levels = f"{len(people)} participants, {scenes} scenes, {styles} styles"
        notes.append(f"{name}: {len(choices)} answers, {prefer} with a preference; {levels}.")
    if not answered:
        raise UserError(f"no answer of {folder} is about images of these results: {next(iter(lost))}")
    notes += [f"{count} answers are left out: {reason}." for reason, count in lost.items()]
    of_scenes = {(one.method, one.seed, one.scene, one.guide): one.figures for one in figures.scenes}
    scores = {row.cell: of_scenes.get((*row.cell[:3], row.guide), {}) | row.figures for row in figures.cells}
    found: list[RankCorrelation] = []
    unknown: Counter[str] = Counter()
    for question, choices in answered.items():
        rows: list[RankCorrelation] = []
        for name, info in figures.metrics.items():
            order = ordered([[as_number(scores[cell].get(name)) for cell in choice.cells] for choice in choices])
            unknown[name] += int(np.isnan(order).sum())
            if np.nansum(np.abs(order)):
                rows.append(correlation(question, name, choices, order if info.better == "higher" else -order))
        adjusted = holm([math.nan if checks.doubt else as_number(one.pvalue) for one in rows])
        found += [replace(one, holm=as_figure(pvalue)) for one, pvalue in zip(rows, adjusted, strict=True)]
    shown = {name: info for name, info in figures.metrics.items() if any(one.figure == name for one in found)}
    total = sum(map(len, answered.values()))
    notes += [f"{name} is unknown in {unknown[name]} of {total} answers." for name in shown if unknown[name]]
    if left := [name for name in figures.metrics if name not in shown]:
        notes.append(f"Left out, without figures or the same for all methods: {', '.join(left)}.")
    if wholes := sorted({name for one in figures.scenes for name in one.figures} & shown.keys()):
        notes.append(f"One figure for all styles of a scene orders its methods alike in each: {', '.join(wholes)}.")
    others = [correlation(name, OTHERS, choices, majority(choices)) for name, choices in answered.items()]
    notes += [f"There is no conclusion: {checks.doubt}."] * bool(checks.doubt)
    methods = sorted({cell.method for choices in answered.values() for choice in choices for cell in choice.cells})
    return People(figures.track, study, methods, shown, found, others, notes)


def _lost(cell: Cell, figures: Figures, seen: str, judged: CellFigures | None) -> str:
    """Why answers about a cell, whose images had the hash ``seen``, are left out; empty if they are not."""
    if cell.method not in figures.methods:
        return f"the results have no method {cell.method}"
    if judged is None:
        return f"the results have no {cell.style} of {cell.scene} by {cell.method}"
    differ = seen and judged.images and seen != judged.images
    return f"people saw other images of {cell.method} than those judged" if differ else ""


def ordered(pairs: Sequence[Sequence[float]]) -> Float[np.ndarray, " N"]:
    """1 where the first of two numbers is greater, -1 the second, 0 for a tie, ``nan`` if one is unknown."""
    first, second = np.array(pairs).T
    return compared(second, first)


def majority(choices: Sequence[Choice]) -> Float[np.ndarray, " N"]:
    """For each answer 1 if most of the others prefer the first cell of its set, -1 the second, 0 neither.

    ``nan`` where nobody else answered. The correlation with it is the lower bound of the noise ceiling (Nili et al.,
    PLOS Computational Biology 2014).
    """
    votes = np.array([choice.vote for choice in choices])
    sets = np.unique([choice.item for choice in choices], return_inverse=True)[1]
    sums, counts = np.bincount(sets, votes)[sets], np.bincount(sets)[sets]
    return np.where(counts > 1, np.sign(sums - votes), np.nan)


def correlation(
    question: str, figure: str, choices: Sequence[Choice], order: Float[np.ndarray, " N"]
) -> RankCorrelation:
    """Somers' D given the answers of an ``order``, which is 1 where the first cell is the better one, -1 the second."""
    known = [(choice, one) for choice, one in zip(choices, order.tolist(), strict=True) if not math.isnan(one)]
    pairs = [(choice, one) for choice, one in known if choice.vote]
    agree = np.array([choice.vote * one for choice, one in pairs])
    people, person = np.unique([choice.participant for choice, _ in pairs], return_inverse=True)
    places, place = np.unique([choice.place for choice, _ in pairs], return_inverse=True)
    scenes, styles = (tuple(name.split("/")[side] for name in places.tolist()) for side in (0, 1))
    names = tuple(people.tolist()), tuple(places.tolist())
    responses = Responses(question, agree, person, place, *names, item_scenes=scenes, item_styles=styles)
    d, low, high, pvalue = (agree.mean() if len(pairs) else math.nan), math.nan, math.nan, math.nan
    if (crossed := crossed_mean(responses)) is not None:
        low, high = np.clip(crossed.interval(CONFIDENCE), -1, 1)
        pvalue = t_pvalue(float(crossed.mean / crossed.error), float(crossed.df), "two-sided")
    shown = np.array([[cell.method for cell in choice.cells] for choice, _ in pairs])
    rests = [agree[(shown != name).all(1)] for name in np.unique(shown)]
    without = [rest.mean() for rest in rests if len(rest)] or [math.nan]
    return RankCorrelation(
        question=question,
        figure=figure,
        d=_figure(d),
        low=_figure(low),
        high=_figure(high),
        pvalue=_figure(pvalue),
        agrees=_figure((1 + d) / 2),
        without=(_figure(min(without)), _figure(max(without))),
        pairs=len(pairs),
        undecided=len(known) - len(pairs),
        ties=int((agree == 0).sum()),
        participants=len(people),
        scenes=len(set(scenes)),
        styles=len(set(styles)),
        generalizes_to=responses.populations,
    )


def _figure(value: float) -> Figure:
    return as_figure(rounded(float(value)))
