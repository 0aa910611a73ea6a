"""The layout of a folder of results: what ``run`` writes, and ``judge`` and ``compare`` read.

::

    RESULTS/track.json                          which track, and the hashes of its inputs
    RESULTS/METHOD/method.json                  the method's spec
    RESULTS/METHOD/SEED/SCENE/STYLE/VIEW.png    the judged views
    RESULTS/METHOD/SEED/SCENE/STYLE.json        a Record: what the cell took, or why there is nothing
    RESULTS/figures.json                        Figures, by ``judge``
"""

import gzip
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct
from PIL import Image

from anystyle.errors import UserError, one_line
from anystyle.io.atomic import write_json
from anystyle.io.documents import MAX_BYTES, Number, kept_json, parse_json, parsing, read_json
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.track import PROTOCOL, Inputs

FIGURES, PACKED = "figures.json", "figures.json.gz"


class Lock(Struct, frozen=True):
    """The track that results belong to."""

    name: str
    version: int
    protocol: int
    digest: str
    hashes: dict[str, str]


class Origin(Struct, frozen=True, kw_only=True):
    """What images were made by; empty where nothing was run, or where it is not known.

    Args:
        code: Commit of the checkout, with ``+`` where files differ from it.
        versions: Versions of the packages that ran.
        weights: SHA-256 of the networks' files, by their names.
        machine: Processor and number of cores.
    """

    code: str = ""
    versions: dict[str, str] = msgspec.field(default_factory=dict)
    weights: dict[str, str] = msgspec.field(default_factory=dict)
    machine: str = ""

    @property
    def key(self) -> str:
        """A short hash that identifies it."""
        return hashlib.sha256(msgspec.json.encode(self, order="sorted")).hexdigest()[:12]


class Record(Struct, frozen=True):
    """How a cell went: whether it has images, and one line on why not.

    Args:
        seconds: CPU seconds of this style, without those per scene; ``None`` where unknown.
        scene_seconds: CPU seconds per scene, such as of fitting it; 0 where not reported, ``None`` where an earlier
            result was reused.
        memory: Peak resident memory of its processes, in MiB; ``None`` where nothing was run.
    """

    status: Literal["done", "failed", "timeout", "missing"]
    message: str = ""
    seconds: float | None = None
    scene_seconds: float | None = 0.0
    memory: float | None = None
    origin: Origin = Origin()


class Cell(NamedTuple):
    """A method's images of a scene in a style."""

    method: str
    seed: int
    scene: str
    style: str

    def images(self, root: Path) -> Path:
        """The folder with ``VIEW.png``."""
        return root / self.method / str(self.seed) / self.scene / self.style

    def record(self, root: Path) -> Path:
        """The file of its :class:`Record`."""
        return self.images(root).with_name(f"{self.style}.json")


class MetricInfo(Struct, frozen=True):
    """A column: ``better`` is ``higher`` or ``lower``, ``metric`` the plugin, whose first figure is shown first.

    ``weights`` are hashes of the files of its networks.
    """

    title: str
    better: str
    reference: str = ""
    stand_in: str = ""
    metric: str = ""
    weights: dict[str, str] = msgspec.field(default_factory=dict)


class CellFigures(Struct, frozen=True):
    """The figures of a cell, or what its record says.

    ``images`` is a hash of its images' files, and ``origin`` the key of what made them in :attr:`Figures.origins`.
    """

    method: str
    seed: int
    scene: str
    style: str
    guide: str
    status: str
    message: str = ""
    seconds: float | None = None
    scene_seconds: float | None = 0.0
    memory: float | None = None
    figures: dict[str, Number] = msgspec.field(default_factory=dict)
    images: str = ""
    origin: str = ""

    @property
    def place(self) -> tuple[str, ...]:
        """Scene and style."""
        return self.scene, self.style

    @property
    def cell(self) -> Cell:
        """Whose figures these are."""
        return Cell(self.method, self.seed, self.scene, self.style)


class SceneFigures(Struct, frozen=True):
    """Figures that a scene has over all its styles together, such as ArtFID."""

    method: str
    seed: int
    scene: str
    guide: str
    figures: dict[str, Number]

    @property
    def place(self) -> tuple[str, ...]:
        """The scene."""
        return (self.scene,)


class Interval(Struct, frozen=True):
    """A mean over ``n`` cells or scenes with its 95 % interval for new scenes and styles."""

    mean: Number
    low: Number
    high: Number
    n: int


class TableRow(Struct, frozen=True):
    """A method's figures over all cells of a guide."""

    method: str
    guide: str
    cells: int
    failed: int
    figures: dict[str, Interval]


class Figures(Struct, frozen=True):
    """All that ``judge`` found: figures of cells, of all styles of a scene together, and over scenes and styles.

    ``metrics`` are the columns in order, ``methods`` the specs as in ``METHOD/method.json``.
    """

    track: Lock
    metrics: dict[str, MetricInfo]
    methods: dict[str, Spec]
    cells: list[CellFigures]
    scenes: list[SceneFigures]
    table: list[TableRow]
    origins: dict[str, Origin] = msgspec.field(default_factory=dict)

    def cells_of(self, method: str, guide: str) -> list[CellFigures]:
        """The cells of a method by a guide."""
        return [cell for cell in self.cells if (cell.method, cell.guide) == (method, guide)]


def bind(inputs: Inputs, root: Path) -> Lock:
    """The lock of a folder of results, which is written if there is none; another track's or version's is refused."""
    track = inputs.track
    lock = Lock(track.name, track.version, PROTOCOL, inputs.digest, inputs.hashes)
    if not (root / "track.json").exists():
        write_json(root / "track.json", msgspec.to_builtins(lock))
        return lock
    kept = read_lock(root)
    if kept.digest != lock.digest:
        raise UserError(f"{root} cannot hold results of {inputs.file}: {_of_other_track(kept, lock)}; use another")
    return lock


def read_lock(root: Path) -> Lock:
    """The lock of a folder of results."""
    return read_json(root / "track.json", Lock, what="record of the results' track")


def read_figures(root: Path) -> Figures:
    """What the judge found in a folder of results, or in a file of figures, which may be packed by gzip."""
    path = root if root.suffix in (".json", ".gz") else root / FIGURES
    if path.name == FIGURES and not path.is_file() and path.with_name(PACKED).is_file():
        path = path.with_name(PACKED)
    if not path.is_file():
        raise UserError(f"there is no {path}; run `anystyle benchmark judge {path.parent}` first")
    if path.suffix == ".json":
        return read_json(path, Figures, what="file of figures")
    with parsing(path, "packed file of figures"), gzip.open(path) as file:
        text = file.read(MAX_BYTES)
    return parse_json(text, Figures, source=str(path), what="file of figures")


def _of_other_track(track: Lock, other: Lock) -> str:
    words = [f"track {one.name} {one.version}, judge {one.protocol}" for one in (track, other)]
    return "its inputs differ" if words[0] == words[1] else f"it is of {words[0]}, not of {words[1]}"


def differing(track: Lock, metrics: Mapping[str, MetricInfo], others: Figures) -> str:
    """Why the scores of others cannot stand beside those of a track and its metrics; empty where they can."""
    if others.track.digest != track.digest:
        return _of_other_track(others.track, track)
    both = [(name, metrics[name], others.metrics[name]) for name in metrics if name in others.metrics]
    strange = [name for name, one, other in both if (one.stand_in, one.weights) != (other.stand_in, other.weights)]
    return f"other networks computed {', '.join(sorted(strange))}" if strange else ""


def joined(figures: Figures, others: Figures) -> Figures:
    """The scores with those methods of others that they lack; :func:`differing` says whether they fit together."""
    names = others.methods.keys() - figures.methods.keys()
    return msgspec.structs.replace(
        figures,
        metrics=figures.metrics
        | {name: others.metrics[name] for name in others.metrics if name not in figures.metrics},
        methods=dict(sorted((figures.methods | {name: others.methods[name] for name in names}).items())),
        cells=[*figures.cells, *(cell for cell in others.cells if cell.method in names)],
        scenes=[*figures.scenes, *(scene for scene in others.scenes if scene.method in names)],
        table=[*figures.table, *(row for row in others.table if row.method in names)],
        origins=dict(sorted((others.origins | figures.origins).items())),
    )


def cells_of(root: Path, method: str) -> Iterator[Cell]:
    """Every cell of a method that has a record, in order of the paths."""
    for path in sorted((root / method).glob("*/*/*.json")):
        seed, scene = path.parts[-3:-1]
        if seed.isdecimal():
            yield Cell(method, int(seed), scene, path.stem)


def is_done(cell: Cell, root: Path) -> bool:
    """Whether a cell has images."""
    record = kept_json(cell.record(root), Record)
    return record is not None and record.status == "done" and cell.images(root).is_dir()


def digest(value: object) -> str:
    """A hash of a value that JSON can hold."""
    return hashlib.sha256(msgspec.json.encode(value)).hexdigest()


def wrong_images(folder: Path, views: Sequence[str], size: tuple[int, int]) -> list[str]:
    """What is wrong with the images ``VIEW.png`` of a cell, a line each; nothing if they can be judged."""
    return [line for view in views if (line := _wrong(folder / f"{view}.png", f"{size[1]}x{size[0]}"))]


def _wrong(path: Path, size: str) -> str:
    name = f"{path.parent.name}/{path.name}"
    if not path.is_file():
        return f"there is no {name}"
    try:
        with Image.open(path) as image:
            image.load()
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        return f"{name} is not a readable image ({one_line(error)})"
    if (found := f"{image.width}x{image.height}") != size:
        return f"{name} is {found}; {size} is expected"
    return "" if image.mode == "RGB" else f"{name} has mode {image.mode}; 8-bit RGB is expected"
