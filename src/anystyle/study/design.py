"""From folders of results to a study: sets, positions, orders, pictures and a report on the balance."""

import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Int
from PIL import Image

from anystyle.io.atomic import atomic_directory, write_json
from anystyle.study import pictures
from anystyle.study.balance import balanced_positions, balanced_subsets, draw_pairs, latin_orders, spread_checks
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
        ValueError: The folders lack what the plan needs, a picture cannot be read, or ``out`` holds answers.
    """
    answers = sorted(out.glob("*.sqlite")) if out.is_dir() else []
    if answers:
        raise ValueError(f"{answers[0]} holds answers to the study that is there; design another one elsewhere")
    material = _find(sources)
    generator = np.random.default_rng(plan.seed)
    available = np.array(
        [[material.complete(scene, style) for style in material.style_names] for scene in material.scenes]
    )
    pairs = np.array(draw_pairs(available, plan.pool or plan.sets, generator))
    baselines = tuple(name for name in sources.methods if name != sources.ours)
    against = generator.permutation(np.arange(len(pairs)) % len(baselines))
    with atomic_directory(out) as folder:
        writer = _Writer(folder / PICTURES, plan, generator)
        items, notes = [], []
        for number, ((row, column), rival) in enumerate(zip(pairs, against, strict=True), start=1):
            place = material.scenes[row], material.style_names[column]
            item, cut = _item(material, writer, f"set-{number:03d}", place, (sources.ours, baselines[int(rival)]))
            items.append(item)
            notes += cut
        checks = _degraded(material, writer, items, sources.ours)
        participants, repeats = _participants(plan, items, checks, pairs, generator)
        study = Study(
            id="",
            ours=sources.ours,
            baselines=baselines,
            plan=plan,
            items=tuple(items),
            checks=(*checks, *repeats),
            participants=participants,
        )
        writer.digest.update(msgspec.json.encode(study, order="deterministic"))
        study = msgspec.structs.replace(study, id=writer.digest.hexdigest()[:12])
        study.write(folder)
        report = balance(study) | {"left_out": [*material.left_out, *notes]}
        write_json(folder / "balance.json", report)
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


class _Writer:
    """Pictures under names that tell nothing; ``digest`` is of them all, so that a study's id is."""

    def __init__(self, folder: Path, plan: Plan, generator: np.random.Generator) -> None:
        folder.mkdir()
        self.folder, self.plan, self.generator = folder, plan, generator
        self.digest = hashlib.sha256()

    def picture(self, image: Image.Image) -> str:
        name = f"{self.generator.bytes(6).hex()}.jpg"
        pictures.write_picture(image, self.folder / name)
        self.digest.update((self.folder / name).read_bytes())
        return name

    def views(self, images: Sequence[Image.Image]) -> tuple[str, ...]:
        """The images, or one video of them with its first image beside it under the same name."""
        names = tuple(map(self.picture, images if self.plan.show != "video" else images[:1]))
        if self.plan.show != "video" or len(images) == 1:
            return names
        video = Path(names[0]).with_suffix(".mp4").name
        pictures.write_video(images, self.folder / video, self.plan.frames_per_second)
        return (video,)


def _item(
    material: _Material, writer: _Writer, identity: str, place: tuple[str, str], methods: tuple[str, str]
) -> tuple[Item, list[str]]:
    """Make every picture of a set the same size; tell where that cut something off."""
    scene, style = place
    plan = writer.plan
    frames = pictures.matching_frames([material.results[name].frames[place] for name in methods], plan.views)
    contents = material.contents[scene]
    named = [frame for frame in contents if frame.stem in {frame.stem for frame in frames[0]}]
    frames.append(named if len(named) == plan.views else pictures.spread(contents, plan.views))
    shape = pictures.read_picture(frames[0][0]).size
    size = pictures.fitted_size(shape, plan.image_size)
    views, notes = [], []
    for group in frames:
        images = [pictures.read_picture(frame) for frame in group]
        ratio = (images[0].width / images[0].height) / (shape[0] / shape[1])
        if not 0.98 < ratio < 1.02:
            notes.append(f"{identity}: {group[0].name} has other proportions than ours and was cut to fit")
        views.append(writer.views([pictures.filled(image, size) for image in images]))
    file = material.styles[style]
    in_words = file.suffix.lower() == ".txt"
    item = Item(
        *(identity, scene, style, methods[1], *views),
        reference="" if in_words else writer.picture(pictures.contained(pictures.read_picture(file), plan.image_size)),
        text=_words(file) if in_words else "",
    )
    return item, notes


def _degraded(material: _Material, writer: _Writer, items: Sequence[Item], ours: str) -> list[Check]:
    """Checks of which one side is spoilt; what is intact is by ours and by the others in turn."""
    checks, plan = [], writer.plan
    for number, item in enumerate(pictures.spread(items, plan.degraded)):
        method = (ours, item.baseline)[number % 2]
        files = pictures.matching_frames([material.results[method].frames[item.scene, item.style]], plan.views)[0]
        images = [pictures.read_picture(file) for file in files]
        size = pictures.fitted_size(images[0].size, plan.image_size)
        images = [pictures.filled(image, size) for image in images]
        spoilt = writer.views([pictures.degraded(image) for image in images])
        identity = f"set-{len(items) + number + 1:03d}"
        checks.append(Check(identity, "degraded", item.id, (item.ours, item.theirs)[number % 2], spoilt))
    return checks


def _words(file: Path) -> str:
    try:
        text = file.read_text(encoding="utf-8").strip()
    except UnicodeDecodeError:
        raise ValueError(f"style {file.name} is not UTF-8 text; save it as UTF-8") from None
    if not text:
        raise ValueError(f"style {file.name} is empty; describe the style in it")
    return text


def _participants(
    plan: Plan,
    items: Sequence[Item],
    checks: Sequence[Check],
    pairs: Int[np.ndarray, "pool 2"],
    generator: np.random.Generator,
) -> tuple[tuple[Participant, ...], tuple[Check, ...]]:
    """What each one sees, and the repeats that this takes."""
    subsets = balanced_subsets(pairs, plan.sets, plan.participants // 2, generator)
    positions = balanced_positions(plan.participants, plan.sets, generator)
    flipped = balanced_positions(plan.participants, 2 * math.ceil(len(checks) / 2), generator) if checks else positions
    orders = latin_orders(plan.participants, plan.sets, generator)
    repeats: dict[str, Check] = {}
    people = []
    for number, (position, order) in enumerate(zip(positions, orders, strict=True)):
        chosen = [items[index] for index in subsets[number // 2]]
        ours_is_a = {item.id for item, first in zip(chosen, position, strict=True) if first}
        ours_is_a |= {check.id for check, first in zip(checks, flipped[number], strict=False) if first}
        sequence = [chosen[index].id for index in order]
        shown = spread_checks(sequence, [check.id for check in checks], generator)
        for index in sorted(generator.choice(plan.sets // 2, plan.repeats, replace=False), reverse=True):
            item = next(item for item in chosen if item.id == sequence[index])
            identity = f"set-{len(items) + len(checks) + len(repeats) + 1:03d}"
            repeat = repeats.setdefault(item.id, Check(identity, "repeat", item.id, item.ours, item.theirs))
            if item.id not in ours_is_a:
                ours_is_a.add(repeat.id)
            # Half a form later at least: far enough to be judged anew.
            earliest = shown.index(item.id) + len(shown) // 2
            shown.insert(int(generator.integers(earliest, len(shown))) + 1, repeat.id)
        code = f"P{number + 1:0{max(2, len(str(plan.participants)))}d}"
        people.append(Participant(code, tuple(shown), frozenset(ours_is_a)))
    return tuple(people), tuple(repeats.values())


def balance(study: Study) -> dict[str, Any]:
    """How even a study is: counts that a perfect design makes equal."""
    sets = {item.id: item for item in study.items}
    orders = [[entry for entry in one.order if entry in sets] for one in study.participants]
    seen = Counter(entry for order in orders for entry in order)
    ours_is_a = Counter(entry for one in study.participants for entry in one.ours_is_a)
    places = Counter((entry, place) for order in orders for place, entry in enumerate(order))
    following = Counter(pair for order in orders for pair in pairwise(order))
    per_person = {
        f"a_{name}_per_participant": _range(
            [Counter(getattr(sets[entry], name) for entry in order)[value] for order in orders for value in values]
        )
        for name, values in (
            ("scene", {item.scene for item in study.items}),
            ("style", {item.style for item in study.items}),
        )
    }
    return {
        "participants": len(study.participants),
        "sets": len(sets),
        "per_scene": dict(sorted(Counter(item.scene for item in study.items).items())),
        "per_style": dict(sorted(Counter(item.style for item in study.items).items())),
        "per_baseline": dict(sorted(Counter(item.baseline for item in study.items).items())),
        "participants_per_set": _range([seen[entry] for entry in sets]),
        "ours_is_a_per_participant": _range([len(one.ours_is_a & sets.keys()) for one in study.participants]),
        "ours_is_a_per_set": _range([ours_is_a[entry] for entry in sets]),
        **per_person,
        "times_a_set_stands_in_a_place": _range([places[entry, p] for entry in sets for p in range(study.plan.sets)]),
        "times_a_set_follows_another": _range([following[a, b] for a in sets for b in sets if a != b]),
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
