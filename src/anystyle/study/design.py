"""From folders of results to a study: sets, positions, orders, pictures and a report on the balance."""

import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from anystyle.io.atomic import atomic_directory
from anystyle.study import pictures
from anystyle.study.balance import balanced_positions, balanced_subsets, draw_pairs, latin_orders, spread_checks
from anystyle.study.protocol import PICTURES, Check, Item, Participant, Plan, Study
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
    usable: frozenset[tuple[str, str]]
    left_out: tuple[str, ...]

    def pairs(self, count: int, generator: np.random.Generator) -> list[tuple[str, str]]:
        scenes, styles = (sorted(set(names)) for names in zip(*self.usable, strict=True))
        available = np.array([[(scene, style) in self.usable for style in styles] for scene in scenes])
        return [(scenes[row], styles[column]) for row, column in draw_pairs(available, count, generator)]


def design(sources: Sources, plan: Plan, out: Path) -> Study:
    """Draw a study and write ``study.json``, the pictures and ``balance.md`` into ``out``.

    Raises:
        ValueError: The folders lack what the plan needs, a picture cannot be read, or ``out`` holds answers.
    """
    answers = sorted(out.glob("*.sqlite")) if out.is_dir() else []
    if answers:
        raise ValueError(f"{answers[0]} holds answers to the study that is there; design another one elsewhere")
    material = _find(sources)
    generator = np.random.default_rng(plan.seed)
    pairs = material.pairs(plan.pool or plan.sets, generator)
    baselines = tuple(name for name in sources.methods if name != sources.ours)
    against = generator.permutation(np.arange(len(pairs)) % len(baselines))
    with atomic_directory(out) as folder:
        writer = _Writer(folder / PICTURES, plan, generator)
        spoilt = pictures.spread(range(len(pairs)), plan.degraded)
        items, checks, notes = [], [], list(material.left_out)
        for number, (pair, rival) in enumerate(zip(pairs, against.tolist(), strict=True)):
            groups, cut = _images(material, plan, pair, (sources.ours, baselines[rival]))
            item = _item(f"set-{number + 1:03d}", material, writer, pair, baselines[rival], groups)
            items.append(item)
            notes += [f"{item.id}: {name} has other proportions than ours and was cut to fit" for name in cut]
            if number in spoilt:  # what is intact is by ours and by the others in turn
                turn = len(checks) % 2
                files = writer.views([pictures.degraded(image) for image in groups[turn]])
                identity = f"set-{len(pairs) + len(checks) + 1:03d}"
                checks.append(Check(identity, "degraded", item.id, (item.ours, item.theirs)[turn], files))
        participants, repeats = _participants(plan, items, checks, generator)
        study = Study("", sources.ours, baselines, plan, tuple(items), (*checks, *repeats), participants)
        writer.digest.update(msgspec.json.encode(study, order="deterministic"))
        study = msgspec.structs.replace(study, id=writer.digest.hexdigest()[:12])
        study.write(folder)
        (folder / "balance.md").write_text(balance_text(study, notes), encoding="utf-8")
    return study


def _find(sources: Sources) -> _Material:
    results = {name: pictures.find_results(name, folder) for name, folder in sources.methods.items()}
    styles, contents = pictures.find_styles(sources.styles), pictures.find_contents(sources.contents)
    usable, left_out = set(), []
    for scene, style in sorted({pair for frames in results.values() for pair in frames}):
        lacking = [name for name, frames in results.items() if (scene, style) not in frames]
        lacking += ["the photographs"] * (scene not in contents) + ["the styles"] * (style not in styles)
        if lacking:
            left_out.append(f"{scene} / {style}: not among {', '.join(lacking)}")
        else:
            usable.add((scene, style))
    if not usable:
        raise ValueError(
            f"no scene and style have results of all of {', '.join(results)} and are among the photographs and styles; "
            f"names must match, and found were {'; '.join(left_out[:3])}"
        )
    return _Material(results, styles, contents, frozenset(usable), tuple(left_out))


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


def _images(
    material: _Material, plan: Plan, pair: tuple[str, str], methods: tuple[str, str]
) -> tuple[list[list[Image.Image]], list[str]]:
    """The views of ours, of the other method and of the photographs in one size; the names of those cut to fit."""
    frames = pictures.matching_frames([material.results[name][pair] for name in methods], plan.views)
    contents = material.contents[pair[0]]
    named = [frame for frame in contents if frame.stem in {frame.stem for frame in frames[0]}]
    frames.append(named if len(named) == plan.views else pictures.spread(contents, plan.views))
    shape = pictures.read_picture(frames[0][0]).size
    size = pictures.fitted_size(shape, plan.image_size)
    groups, cut = [], []
    for group in frames:
        images = []
        for frame in group:
            image = pictures.read_picture(frame)
            if not 0.98 < (image.width / image.height) / (shape[0] / shape[1]) < 1.02 and not images:
                cut.append(frame.name)
            images.append(pictures.filled(image, size))
        groups.append(images)
    return groups, cut


def _item(
    identity: str,
    material: _Material,
    writer: _Writer,
    pair: tuple[str, str],
    baseline: str,
    groups: Sequence[Sequence[Image.Image]],
) -> Item:
    ours, theirs, content = (writer.views(images) for images in groups)
    file = material.styles[pair[1]]
    if file.suffix.lower() == ".txt":
        return Item(identity, *pair, baseline, ours, theirs, content, text=_words(file))
    style = pictures.contained(pictures.read_picture(file), writer.plan.image_size)
    return Item(identity, *pair, baseline, ours, theirs, content, reference=writer.picture(style))


def _words(file: Path) -> str:
    try:
        text = file.read_text(encoding="utf-8").strip()
    except UnicodeDecodeError:
        raise ValueError(f"style {file.name} is not UTF-8 text; save it as UTF-8") from None
    if not text:
        raise ValueError(f"style {file.name} is empty; describe the style in it")
    return text


def _participants(
    plan: Plan, items: Sequence[Item], checks: Sequence[Check], generator: np.random.Generator
) -> tuple[tuple[Participant, ...], tuple[Check, ...]]:
    """What each one sees, and the repeats that this takes."""
    columns = ([item.scene for item in items], [item.style for item in items])
    pairs = np.stack([np.unique(column, return_inverse=True)[1] for column in columns], axis=1)
    subsets = balanced_subsets(pairs, plan.sets, plan.participants // 2, generator)
    positions = balanced_positions(plan.participants, plan.sets, generator)
    flipped = balanced_positions(plan.participants, 2 * math.ceil(len(checks) / 2), generator) if checks else positions
    orders = latin_orders(plan.participants, plan.sets, generator)
    repeats: dict[str, Check] = {}
    people = []
    for number, (position, order) in enumerate(zip(positions, orders, strict=True)):
        chosen = [items[index] for index in subsets[number // 2]]
        ours_is_a = {item.id for item, first in zip(chosen, position, strict=True) if first}
        ours_is_a |= {check.id for check, first in zip(checks, flipped[number][: len(checks)], strict=True) if first}
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


def balance(study: Study) -> dict[str, tuple[int, int]]:
    """How even a study is: the least and the most of counts that a perfect design makes equal."""
    sets = {item.id: item for item in study.items}
    orders = [[entry for entry in person.order if entry in sets] for person in study.participants]
    seen = Counter(entry for order in orders for entry in order)
    ours_is_a = Counter(entry for person in study.participants for entry in person.ours_is_a)
    standing = Counter((entry, rank) for order in orders for rank, entry in enumerate(order))
    following = Counter(pair for order in orders for pair in pairwise(order))
    counts = {
        **{f"sets per {name}": _count(study.items, name) for name in ("scene", "style", "baseline")},
        "participants per set": [seen[entry] for entry in sets],
        "ours is A per participant": [len(person.ours_is_a & sets.keys()) for person in study.participants],
        "ours is A per set": [ours_is_a[entry] for entry in sets],
        **{
            f"a {name} per participant": [
                count for order in orders for count in _count([sets[entry] for entry in order], name, study.items)
            ]
            for name in ("scene", "style")
        },
        "times a set stands in a place": [standing[entry, rank] for entry in sets for rank in range(study.plan.sets)],
        "times a set follows another": [following[a, b] for a in sets for b in sets if a != b],
    }
    return {name: (min(values), max(values)) for name, values in counts.items()}


def _count(items: Sequence[Item], name: str, among: Sequence[Item] = ()) -> list[int]:
    """How often each scene, style or baseline of ``among`` is in ``items``."""
    times = Counter(getattr(item, name) for item in items)
    return [times[value] for value in {getattr(item, name) for item in among or items}]


def balance_text(study: Study, notes: Sequence[str]) -> str:
    """The balance, and what was left out or cut, as Markdown."""
    lines = [f"# Balance\n\n{len(study.participants)} participants, {len(study.items)} sets.\n"]
    lines += ["| what | least | most |\n|---|---:|---:|"]
    lines += [f"| {name} | {least} | {most} |" for name, (least, most) in balance(study).items()]
    if notes:
        lines += ["\n## Left out or cut\n", *(f"- {escape_markdown(note)}" for note in notes)]
    return "\n".join(lines) + "\n"
