"""The lines that ``anystyle stylize`` prints while it works, as sentences and a fraction."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from anystyle_start.library import ERROR, Kind

_LINE = re.compile(r"(\w+) (.*) …")
_COUNT = re.compile(r"(\d+)(?: of |/)(\d+)")
_LEFT = re.compile(r"(\d+) s left")
_CACHED = "read from the cache"
_UNMASKED = "photographs have no mask in "

STEPS: Mapping[str, tuple[tuple[str, tuple[str, ...], float], ...]] = {
    "fitted": (
        ("Read", ("load", "embed", "read"), 0.05),
        ("Cameras", ("cameras", "encode"), 0.3),
        ("Build", ("fit",), 0.45),
        ("Paint", ("render", "restyle"), 0.15),
        ("Write", ("write",), 0.05),
    ),
    "given": (
        ("Read", ("load", "embed", "read", "encode"), 0.4),
        ("Paint", ("render", "restyle"), 0.5),
        ("Write", ("write",), 0.1),
    ),
}
"""For photographs and films, and for splats: the steps of a run, the stages of each, and its share of the time."""

_CAMERAS = {
    "features": "looking for points to recognise in photograph {0} of {1}",
    "matches": "comparing photographs, {0} of {1} pairs",
    "mapping": "placing photographs, {0} of {1}",
}


@dataclass(frozen=True)
class State:
    """How far a run is."""

    sentence: str = "Starting."  # for people
    step: int = 0  # the index in the steps of its kind
    done: float = 0.0  # the fraction of the whole that is done, in [0, 1]
    notes: tuple[str, ...] = ()  # warnings so far
    error: str = ""  # why it failed


def steps_of(kind: Kind | None) -> tuple[tuple[str, tuple[str, ...], float], ...]:
    """The steps of a run on inputs of a kind."""
    return STEPS["given" if kind == "splat" else "fitted"]


def follow(state: State, line: str, kind: Kind | None) -> State:
    """The state after another line of the program."""
    line = line.rstrip()
    if line.startswith(ERROR):
        return replace(state, error=line.removeprefix(ERROR))
    match = _LINE.fullmatch(line)
    steps = steps_of(kind)
    known = {stage: index for index, (_, stages, _) in enumerate(steps) for stage in stages}
    if match is None or match[1] not in known:
        untold = (*state.notes, "") if _UNMASKED not in line else (line,)  # the page shows which have masks
        is_note = line not in untold and not line[0].isspace() and not line.startswith("Traceback")
        return replace(state, notes=(*state.notes, line[:1000])[-20:]) if is_note else state
    stage, rest = match.groups()
    step = known[stage]
    count = _COUNT.search(rest)
    part = (int(count[1]) - (stage == "restyle")) / max(int(count[2]), 1) if count and stage != "encode" else 0.0
    if stage == "cameras":  # each of the three parts counts for itself
        index = next((index for index, word in enumerate(_CAMERAS) if rest.startswith(word)), 0)
        part = (index + part) / len(_CAMERAS) if count else 0.0
    before = sum(share for _, _, share in steps[:step])
    done = max(state.done, before + min(max(part, 0.0), 1.0) * steps[step][2])
    return replace(state, sentence=_sentence(stage, rest, kind), step=step, done=done)


def _sentence(stage: str, rest: str, kind: Kind | None) -> str:
    count, left = _COUNT.search(rest), _LEFT.search(rest)
    what = {"film": "the film", "splat": "the splat"}.get(str(kind), "the photographs")
    if _CACHED in rest:
        return f"{'The cameras are' if stage == 'cameras' else 'The scene is'} known from an earlier run."
    if stage == "cameras":
        word = next((words for name, words in _CAMERAS.items() if rest.startswith(name)), None)
        more = f": {word.format(count[1], count[2])}" if word and count else f" of {rest.removeprefix('of ')}"
        return f"Finding where each photograph was taken{more}." if word else f"Finding the cameras{more}."
    if stage == "fit":
        soon = f", about {left[1]} seconds left" if left else ""
        return f"Building the scene: step {count[1]} of {count[2]}{soon}." if count else "Building the scene."
    if stage == "restyle":
        number, _, title = rest.partition(": ")
        return f"Painting style {number.replace('/', ' of ')}: {title}." if title else f"Painting: {rest}."
    sentences = {
        "load": "Loading the networks.",
        "embed": "Looking at the styles.",
        "read": f"Reading {what}.",
        "encode": f"Looking at {what}.",
        "render": "Drawing the scene without a style.",
        "write": "Writing the scene, its pictures and its film.",
    }
    return sentences[stage]
