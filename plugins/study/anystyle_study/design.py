"""Design of a study from folders of results: sets, positions, orders, pictures, and a report on the balance."""

import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image, ImageOps

from anystyle.errors import UserError
from anystyle.evaluation.names import folded
from anystyle.evaluation.tables import Table, escape_markdown
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import read_text
from anystyle_study import pictures
from anystyle_study.balance import balanced_positions, balanced_subsets, draw_pairs, latin_orders, spread_checks
from anystyle_study.protocol import PICTURES, Check, Item, Participant, Plan, Study


@dataclass(frozen=True)
class Sources:
    """Folders that a study's pictures come from."""

    methods: Mapping[str, Path]  # folders of results, by name of the method
    ours: str  # the method that the study is about
    styles: Path  # folder of style images and texts
    contents: Path  # folder of photographs

    def __post_init__(self) -> None:
        if len(self.methods) < 2:
            raise UserError(f"{len(self.methods)} method(s) given; a comparison needs two: --method NAME=FOLDER twice")
        if self.ours not in self.methods:
            raise UserError(f"ours is {self.ours!r}, which is not one of the methods {', '.join(self.methods)}")


def design(sources: Sources, plan: Plan, out: Path) -> Study:
    """Draw a study and write ``study.json``, the pictures and ``balance.md`` into ``out``."""
    answers = sorted(out.glob("answers*"))
    if answers:
        raise UserError(f"{answers[0]} holds answers to the study that is there; design another one elsewhere")
    results = {name: pictures.find_results(name, folder) for name, folder in sources.methods.items()}
    style_files, contents = pictures.find_styles(sources.styles), pictures.frames_by_name(sources.contents, "contents")
    usable, left_out = _usable(results, style_files, contents)
    generator = np.random.default_rng(plan.seed)
    scenes, styles = (sorted(set(names)) for names in zip(*usable, strict=True))
    available = np.array([[(scene, style) in usable for style in styles] for scene in scenes])
    baselines = tuple(name for name in sources.methods if name != sources.ours)
    sets = plan.pool or plan.sets
    of_ours = plan.pairs == "ours"
    rivals = [(sources.ours, name) for name in baselines] if of_ours else [*combinations(sources.methods, 2)]
    drawn = draw_pairs(np.repeat(available[..., None], len(rivals), axis=2), sets, generator, once=of_ours)
    with atomic_directory(out) as folder:
        writer = _Writer(folder / PICTURES, plan, generator)
        degraded = pictures.spread(range(sets), plan.degraded)
        items, checks, notes = [], [], left_out
        for number, (row, column, rival) in enumerate(drawn):
            pair, (method, other) = (scenes[row], styles[column]), rivals[rival]
            groups, cut = _images([results[name][pair] for name in (method, other)], contents[pair[0]], plan)
            item = _item((f"set-{number + 1:03d}", *pair, other), style_files[pair[1]], writer, groups)
            item = msgspec.structs.replace(item, method=method if plan.pairs == "all" else "")
            items.append(item)
            notes += [f"{item.id}: {name} has other proportions than ours and was cropped" for name in cut]
            if number in degraded:  # by ours and by the others in turn
                turn = len(checks) % 2
                files = writer.views([pictures.degraded(image) for image in groups[turn]])
                identity = f"set-{sets + len(checks) + 1:03d}"
                checks.append(Check(identity, "degraded", item.id, (item.ours, item.theirs)[turn], files))
        participants, repeats = _participants(plan, items, checks, generator)
        study = Study("", sources.ours, baselines, plan, tuple(items), (*checks, *repeats), participants)
        writer.digest.update(msgspec.json.encode(study, order="deterministic"))
        study = msgspec.structs.replace(study, id=writer.digest.hexdigest()[:12])
        study.write(folder)
        (folder / "balance.md").write_text(balance_text(study, notes), encoding="utf-8")
    return study


def _usable(
    results: Mapping[str, pictures.ResultPaths], styles: Mapping[str, Path], contents: Mapping[str, list[Path]]
) -> tuple[set[tuple[str, str]], list[str]]:
    """The scenes and styles that all folders have, and why others are left out."""
    left_out = {}
    pairs = {pair for frames in results.values() for pair in frames}
    for scene, style in sorted(pairs):
        lacking = [name for name, frames in results.items() if (scene, style) not in frames]
        if scene not in contents:
            lacking.append("the photographs")
        if style not in styles:
            lacking.append("the styles")
        if lacking:
            left_out[scene, style] = f"{scene} / {style}: not among {', '.join(lacking)}"
    reasons = list(left_out.values())
    if len(left_out) == len(pairs):
        raise UserError(
            f"no scene and style have results of all of {', '.join(results)} and are among the photographs and styles; "
            f"names must match, and found were {'; '.join(reasons[:3])}"
        )
    return pairs - left_out.keys(), reasons


class _Writer:
    """Writes pictures under meaningless names, the same ones once; ``digest`` hashes them all, for the study's id."""

    def __init__(self, folder: Path, plan: Plan, generator: np.random.Generator) -> None:
        folder.mkdir()
        self.folder, self.plan, self.generator = folder, plan, generator
        self.digest = hashlib.sha256()
        self.written: dict[bytes, tuple[str, ...]] = {}

    def views(self, images: Sequence[Image.Image]) -> tuple[str, ...]:
        """The files of the images, or of one video of them with its first image as the poster."""
        pixels = hashlib.sha256(b"".join(image.tobytes() for image in images)).digest()
        if pixels not in self.written:
            self.written[pixels] = self._write(images)
        return self.written[pixels]

    def _picture(self, image: Image.Image) -> str:
        name = f"{self.generator.bytes(6).hex()}.jpg"
        image.save(self.folder / name, "JPEG", quality=92, subsampling=0, optimize=True)
        self.digest.update((self.folder / name).read_bytes())
        return name

    def _write(self, images: Sequence[Image.Image]) -> tuple[str, ...]:
        from anystyle.data.images import to_tensor
        from anystyle.io.video import write_video

        names = tuple(map(self._picture, images if self.plan.show != "video" else images[:1]))
        if self.plan.show != "video" or len(images) == 1:
            return names
        video = Path(names[0]).with_suffix(".mp4").name
        write_video(map(to_tensor, images), self.folder / video, fps=self.plan.frames_per_second)
        return (video,)


def _images(
    results: Sequence[Sequence[Path]], contents: Sequence[Path], plan: Plan
) -> tuple[list[list[Image.Image]], list[str]]:
    """Views of ours, of the other method and of the photographs in one size, and the names of those cropped to fit."""
    frames = pictures.matching_frames(results, plan.views)
    shown = {folded(frame.stem) for frame in frames[0]}
    named = [frame for frame in contents if folded(frame.stem) in shown]
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
            images.append(ImageOps.fit(image, size, Image.Resampling.LANCZOS))
        groups.append(images)
    return groups, cut


def _item(
    about: tuple[str, str, str, str], file: Path, writer: _Writer, groups: Sequence[Sequence[Image.Image]]
) -> Item:
    """A set by its id, scene, style and baseline, with the style's file."""
    ours, theirs, content = (writer.views(images) for images in groups)
    if file.suffix.lower() == ".txt":
        text = read_text(file, what="style in words").strip()
        if not text:
            raise UserError(f"style {file.name} is empty; describe the style in it")
        return Item(*about, ours, theirs, content, text=text)
    style = pictures.read_picture(file)
    size = pictures.fitted_size(style.size, writer.plan.image_size)
    (reference,) = writer.views([style.resize(size, Image.Resampling.LANCZOS)])
    return Item(*about, ours, theirs, content, reference=reference)


def _participants(
    plan: Plan, items: Sequence[Item], checks: Sequence[Check], generator: np.random.Generator
) -> tuple[tuple[Participant, ...], tuple[Check, ...]]:
    """Order and positions for each participant, and the repeated sets that these need."""
    columns = [[item.scene for item in items], [item.style for item in items]]
    if plan.pairs == "all":
        columns.append([f"{item.method}/{item.baseline}" for item in items])
    factors = np.stack([np.unique(column, return_inverse=True)[1] for column in columns], axis=1)
    subsets = balanced_subsets(factors, plan.sets, plan.participants // 2, generator)
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
            # At least half a form later, so that it is judged again.
            earliest = shown.index(item.id) + len(shown) // 2
            shown.insert(int(generator.integers(earliest, len(shown))) + 1, repeat.id)
        code = f"P{number + 1:0{max(2, len(str(plan.participants)))}d}"
        people.append(Participant(code, tuple(shown), frozenset(ours_is_a)))
    return tuple(people), tuple(repeats.values())


def balance(study: Study) -> dict[str, tuple[int, int]]:
    """Minimum and maximum of counts that are equal in a perfectly balanced design."""
    sets = {item.id: item for item in study.items}
    orders = [[entry for entry in person.order if entry in sets] for person in study.participants]
    seen = Counter(entry for order in orders for entry in order)
    ours_is_a = Counter(entry for person in study.participants for entry in person.ours_is_a)
    ranks = Counter((entry, rank) for order in orders for rank, entry in enumerate(order))
    following = Counter(pair for order in orders for pair in pairwise(order))

    def count(items: Sequence[Item], name: str) -> list[int]:
        times = Counter(getattr(item, name) for item in items)
        return [times[value] for value in {getattr(item, name) for item in study.items}]

    attributes = ("scene", "style")
    shown = Counter(name for item in study.items for name in study.methods(item))
    between = Counter(map(study.methods, study.items))
    per_method = {"sets per method": [*shown.values()], "sets per pair of methods": [*between.values()]}
    counts = {
        **{f"sets per {name}": count(study.items, name) for name in attributes},
        **(per_method if study.plan.pairs == "all" else {"sets per baseline": count(study.items, "baseline")}),
        "participants per set": [seen[entry] for entry in sets],
        "ours is A per participant": [len(person.ours_is_a & sets.keys()) for person in study.participants],
        "ours is A per set": [ours_is_a[entry] for entry in sets],
        "times each set has a rank": [ranks[entry, rank] for entry in sets for rank in range(study.plan.sets)],
        "times each set follows another": [following[a, b] for a in sets for b in sets if a != b],
    }
    judged = [[sets[entry] for entry in order] for order in orders]
    counts |= {f"a {name} per participant": [n for items in judged for n in count(items, name)] for name in attributes}
    return {name: (min(values), max(values)) for name, values in counts.items()}


def balance_text(study: Study, notes: Sequence[str]) -> str:
    """The balance, and what was left out or cropped, as Markdown."""
    rows = tuple((name, str(least), str(most)) for name, (least, most) in balance(study).items())
    table = Table(("count", "minimum", "maximum"), rows).markdown()
    parts = [f"# Balance\n\n{len(study.participants)} participants, {len(study.items)} sets.\n", table]
    if notes:
        parts += ["## Left out or cropped\n", *(f"- {escape_markdown(note)}" for note in notes)]
    return "\n".join(parts).rstrip() + "\n"
