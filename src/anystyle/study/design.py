"""From folders of results to a study: sets, positions, orders, pictures and a report on the balance."""

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from anystyle.io.atomic import atomic_directory
from anystyle.study import pictures
from anystyle.study.balance import balanced_positions, draw_pairs, latin_orders, spread_checks
from anystyle.study.naming import picture_name
from anystyle.study.plan import Plan
from anystyle.study.protocol import PICTURES, Check, Item, Participant, Study
from anystyle.study.tabulate import escape_markdown


@dataclass(frozen=True)
class Sources:
    """Where a study's pictures come from.

    Args:
        methods: Folders of results, by the method's name.
        ours: Which of the methods the study is about.
        styles: The folder of style images and texts.
        contents: The folder of photographs.
    """

    methods: Mapping[str, Path]
    ours: str
    styles: Path
    contents: Path

    def __post_init__(self) -> None:
        if len(self.methods) < 2:
            raise ValueError(f"{len(self.methods)} method(s) given; a comparison needs two: --method NAME=FOLDER twice")
        if self.ours not in self.methods:
            raise ValueError(f"ours is {self.ours!r}, which is none of the methods {', '.join(self.methods)}")


@dataclass(frozen=True)
class _Material:
    """Everything in the folders that a set can be made of."""

    results: Mapping[str, pictures.Results]
    styles: Mapping[str, Path]
    contents: Mapping[str, list[Path]]
    scenes: tuple[str, ...]
    style_names: tuple[str, ...]
    left_out: tuple[str, ...]

    def complete(self, scene: str, style: str) -> bool:
        return all((scene, style) in result.frames for result in self.results.values())


def design(sources: Sources, plan: Plan, out: Path) -> Study:
    """Draw a study and write ``study.json``, the pictures, ``balance.json`` and ``balance.md`` into ``out``.

    Raises:
        ValueError: The folders lack what the plan needs, or a picture cannot be read.
    """
    material = _find(sources)
    generator = np.random.default_rng(plan.seed)
    available = np.array(
        [[material.complete(scene, style) for style in material.style_names] for scene in material.scenes]
    )
    pairs = draw_pairs(available, plan.sets, generator)
    baselines = [name for name in sources.methods if name != sources.ours]
    named = [(material.scenes[scene], material.style_names[style]) for scene, style in pairs]
    described = json.dumps([asdict(plan), sources.ours, baselines, named])
    identity = hashlib.sha256(described.encode()).hexdigest()[:12]
    items = _items(material, sources.ours, baselines, pairs, identity, generator)
    study = _assign(identity, sources.ours, baselines, plan, items, generator)
    with atomic_directory(out) as folder:
        notes = _write_pictures(material, study, folder / PICTURES)
        study.write(folder)
        report = balance(study) | {"left_out": [*material.left_out, *notes]}
        (folder / "balance.json").write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        (folder / "balance.md").write_text(balance_text(report), encoding="utf-8")
    return study


def _find(sources: Sources) -> _Material:
    results = {name: pictures.find_results(name, folder) for name, folder in sources.methods.items()}
    styles, contents = pictures.find_styles(sources.styles), pictures.find_contents(sources.contents)
    pairs = sorted({pair for result in results.values() for pair in result.frames})
    left_out = []
    for scene, style in pairs:
        lacking = [name for name, result in results.items() if (scene, style) not in result.frames]
        lacking += ["the photographs"] * (scene not in contents) + ["the styles"] * (style not in styles)
        if lacking:
            left_out.append(f"{scene} / {style}: not among {', '.join(lacking)}")
    usable = {(scene, style) for scene, style in pairs if scene in contents and style in styles}
    usable = {pair for pair in usable if all(pair in result.frames for result in results.values())}
    if not usable:
        raise ValueError(
            f"no scene and style have results of all of {', '.join(results)} and are among the photographs and styles; "
            f"names must match, and found were {'; '.join(left_out[:3])}"
        )
    return _Material(
        results=results,
        styles=styles,
        contents=contents,
        scenes=tuple(sorted({scene for scene, _ in usable})),
        style_names=tuple(sorted({style for _, style in usable})),
        left_out=tuple(left_out),
    )


def _items(
    material: _Material,
    ours: str,
    baselines: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    identity: str,
    generator: np.random.Generator,
) -> tuple[Item, ...]:
    against = generator.permutation(np.arange(len(pairs)) % len(baselines))
    items = []
    for number, ((row, column), rival) in enumerate(zip(pairs, against, strict=True), start=1):
        scene, style = material.scenes[row], material.style_names[column]
        in_words = material.styles[style].suffix.lower() == ".txt"
        items.append(
            Item(
                id=f"set-{number:02d}",
                scene=scene,
                style=style,
                baseline=baselines[int(rival)],
                ours=picture_name(generator, identity, ours=True),
                theirs=picture_name(generator, identity, ours=False),
                content=picture_name(generator, identity, ours=None),
                reference="" if in_words else picture_name(generator, identity, ours=None),
                text=_words(material.styles[style]) if in_words else "",
            )
        )
    return tuple(items)


def _words(file: Path) -> str:
    try:
        text = file.read_text(encoding="utf-8").strip()
    except UnicodeDecodeError:
        raise ValueError(f"style {file.name} is not UTF-8 text; save it as UTF-8") from None
    if not text:
        raise ValueError(f"style {file.name} is empty; describe the style in it")
    return text


def _assign(
    identity: str,
    ours: str,
    baselines: Sequence[str],
    plan: Plan,
    items: tuple[Item, ...],
    generator: np.random.Generator,
) -> Study:
    low, high = int(plan.scale.low), int(plan.scale.high)
    checks = tuple(Check(f"check-{number + 1}", (high, low)[number % 2]) for number in range(plan.attention_checks))
    positions = balanced_positions(plan.participants, plan.sets, generator)
    orders = latin_orders(plan.participants, plan.sets, generator)
    people = []
    for number, (position, order) in enumerate(zip(positions, orders, strict=True), start=1):
        mixed = spread_checks([items[index].id for index in order], [check.id for check in checks], generator)
        ours_is_a = frozenset(items[index].id for index in np.flatnonzero(position))
        people.append(Participant(f"P{number:0{max(2, len(str(plan.participants)))}d}", tuple(mixed), ours_is_a))
    return Study(
        id=identity,
        ours=ours,
        baselines=tuple(baselines),
        plan=plan,
        items=items,
        checks=checks,
        participants=tuple(people),
    )


def _write_pictures(material: _Material, study: Study, folder: Path) -> list[str]:
    """Make every picture of a set the same size; tell where that cut something off."""
    folder.mkdir(parents=True)
    longest, notes = study.plan.image_size, []
    for item in study.items:
        groups = [material.results[name].frames[item.scene, item.style] for name in (study.ours, item.baseline)]
        frames = pictures.matching_frames([*groups, material.contents[item.scene]])
        ours = pictures.read_picture(frames[0])
        size = pictures.fitted_size(ours.size, longest)
        for name, frame in zip((item.ours, item.theirs, item.content), frames, strict=True):
            image = pictures.read_picture(frame)
            shape = (image.width / image.height) / (ours.width / ours.height)
            if not 0.98 < shape < 1.02:
                notes.append(f"{item.id}: {frame.name} has other proportions than ours and was cut to fit")
            pictures.write_picture(pictures.filled(image, size), folder / f"{name}.jpg")
        if item.reference:
            reference = pictures.contained(pictures.read_picture(material.styles[item.style]), longest)
            pictures.write_picture(reference, folder / f"{item.reference}.jpg")
    return notes


def balance(study: Study) -> dict[str, Any]:
    """How even a study is: counts that a perfect design makes equal."""
    sets = [item.id for item in study.items]
    orders = [[entry for entry in one.order if entry in set(sets)] for one in study.participants]
    ranks = np.array([[order.index(entry) for entry in sets] for order in orders])  # participants by sets
    counts = np.array([np.bincount(ranks[:, column], minlength=len(sets)) for column in range(len(sets))])
    following = Counter(pair for order in orders for pair in pairwise(order))
    return {
        "participants": len(study.participants),
        "sets": len(sets),
        "per_scene": dict(sorted(Counter(item.scene for item in study.items).items())),
        "per_style": dict(sorted(Counter(item.style for item in study.items).items())),
        "per_baseline": dict(sorted(Counter(item.baseline for item in study.items).items())),
        "ours_is_a_per_participant": _range([len(one.ours_is_a) for one in study.participants]),
        "ours_is_a_per_set": _range([sum(entry in one.ours_is_a for one in study.participants) for entry in sets]),
        "times_a_set_stands_in_a_place": _range(counts.ravel().tolist()),
        "times_a_set_follows_another": _range(
            [following[first, second] for first in sets for second in sets if first != second]
        ),
    }


def _range(values: Sequence[int]) -> dict[str, int]:
    return {"least": min(values), "most": max(values)}


def balance_text(report: Mapping[str, Any]) -> str:
    """The balance report as Markdown."""
    lines = [f"# Balance\n\n{report['participants']} participants, {report['sets']} sets.\n", "| what | least | most |"]
    lines.append("|---|---:|---:|")
    for name in ("per_scene", "per_style", "per_baseline"):
        counts = report[name].values()
        lines.append(f"| sets {name.replace('_', ' ')} ({len(counts)}) | {min(counts)} | {max(counts)} |")
    for name, span in report.items():
        if isinstance(span, Mapping) and set(span) == {"least", "most"}:
            lines.append(f"| {name.replace('_', ' ')} | {span['least']} | {span['most']} |")
    if report["left_out"]:
        lines += ["\n## Left out or cut\n", *(f"- {escape_markdown(note)}" for note in report["left_out"])]
    return "\n".join(lines) + "\n"
