"""The layout of a folder of results: what ``run`` writes, and ``judge`` and ``site`` read.

::

    RESULTS/track.json                          which track, and the hashes of its inputs
    RESULTS/METHOD/method.json                  the method's spec
    RESULTS/METHOD/SEED/SCENE/STYLE/VIEW.png    the judged views
    RESULTS/METHOD/SEED/SCENE/STYLE.json        a Record: what the cell took, or why there is nothing
    RESULTS/figures.json                        Figures, by ``judge``
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct
from PIL import Image

from anystyle.errors import UserError, one_line
from anystyle.io.atomic import write_json
from anystyle.io.documents import Figure, kept_json, read_json
from anystyle_benchmark.track import PROTOCOL, Inputs

FIGURES = "figures.json"


class Lock(Struct, frozen=True):
    """The track that results belong to."""

    name: str
    version: int
    protocol: int
    digest: str
    hashes: dict[str, str]


class Record(Struct, frozen=True):
    """How a cell went.

    Args:
        status: Of a method that ran, failed, or took too long.
        message: One line, where it did not run.
        seconds: CPU seconds of this style, without those per scene; ``None`` where unknown.
        scene_seconds: CPU seconds per scene, such as of fitting it; 0 where not reported, ``None`` where an earlier
            result was reused.
        memory: Peak resident memory of its processes, in MiB; ``None`` where nothing was run.
        machine: Processor and number of cores.
        versions: Of what ran.
    """

    status: Literal["done", "failed", "timeout"]
    message: str = ""
    seconds: float | None = None
    scene_seconds: float | None = 0
    memory: float | None = None
    machine: str = ""
    versions: dict[str, str] = msgspec.field(default_factory=dict)


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

    def page(self, root: Path) -> Path:
        """A page with its scene to walk through, where there is one."""
        return self.images(root).with_name(f"{self.style}.html")


class MetricInfo(Struct, frozen=True):
    """What a column is: its title, whether ``higher`` or ``lower`` is better, its reference, a stand-in network.

    ``metric`` is the plugin that computes it; the first figure of each is shown first.
    """

    title: str
    better: str
    reference: str = ""
    stand_in: str = ""
    metric: str = ""


class CellFigures(Struct, frozen=True):
    """The figures of a cell, or what its record says."""

    method: str
    seed: int
    scene: str
    style: str
    guide: str
    status: str
    message: str = ""
    seconds: float | None = None
    scene_seconds: float | None = 0
    memory: float | None = None
    figures: dict[str, Figure] = msgspec.field(default_factory=dict)

    @property
    def place(self) -> tuple[str, ...]:
        """Scene and style."""
        return self.scene, self.style


class SceneFigures(Struct, frozen=True):
    """Figures that a scene has over all its styles together, such as ArtFID."""

    method: str
    seed: int
    scene: str
    guide: str
    figures: dict[str, Figure]

    @property
    def place(self) -> tuple[str, ...]:
        """The scene."""
        return (self.scene,)


class Interval(Struct, frozen=True):
    """A mean with its 95 % interval over new scenes and styles; ``n`` cells or scenes."""

    mean: Figure
    low: Figure
    high: Figure
    n: int


class TableRow(Struct, frozen=True):
    """A method's figures over all cells of a guide."""

    method: str
    guide: str
    cells: int
    failed: int
    figures: dict[str, Interval]


class Figures(Struct, frozen=True):
    """All that ``judge`` found.

    Args:
        track: The track's lock.
        metrics: What the columns are, in order.
        methods: The specs, by name, as in ``METHOD/method.json``.
        cells: Every cell of every method.
        scenes: Figures over the styles of a scene.
        table: Figures over scenes and styles.
    """

    track: Lock
    metrics: dict[str, MetricInfo]
    methods: dict[str, dict]
    cells: list[CellFigures]
    scenes: list[SceneFigures]
    table: list[TableRow]


def bind(inputs: Inputs, root: Path) -> Lock:
    """The lock of a folder of results, which is written if there is none; another track's or version's is refused."""
    track = inputs.track
    lock = Lock(track.name, track.version, PROTOCOL, inputs.digest, inputs.hashes)
    if not (root / "track.json").exists():
        write_json(root / "track.json", msgspec.to_builtins(lock))
        return lock
    kept = read_lock(root)
    if kept.digest != lock.digest:
        names = [f"{one.name} version {one.version}" for one in (kept, lock)]
        if names[0] != names[1]:
            other = f"and not of {names[1]}"
        elif kept.protocol != lock.protocol:
            other = f"judge {kept.protocol}, and this is judge {lock.protocol}"
        else:
            changed = sorted(name for name, _ in kept.hashes.items() ^ lock.hashes.items())
            other = f"and {changed[0] if changed else inputs.file} has changed since; it needs another version"
        raise UserError(f"{root} holds results of track {names[0]}, {other}; use another folder")
    return lock


def read_lock(root: Path) -> Lock:
    """The lock of a folder of results."""
    return read_json(root / "track.json", Lock, what="record of the results' track")


def read_figures(root: Path) -> Figures:
    """What the judge found in a folder of results."""
    path = root / FIGURES
    if not path.is_file():
        raise UserError(f"there is no {path}; run `anystyle benchmark judge {root}` first")
    return read_json(path, Figures, what="file of figures")


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


def wrong_images(folder: Path, views: Sequence[str], size: tuple[int, int]) -> list[str]:
    """What is wrong with the images ``VIEW.png`` of a cell, a line each; nothing if they can be judged."""
    lines: list[str] = []
    for view in views:
        path = folder / f"{view}.png"
        name = f"{folder.name}/{path.name}"
        if not path.is_file():
            lines.append(f"there is no {name}")
            continue
        try:
            with Image.open(path) as image:
                image.load()
                mode, (width, height) = image.mode, image.size
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            lines.append(f"{name} is no readable image ({one_line(error)})")
            continue
        if (height, width) != size:
            lines.append(f"{name} is {width}x{height}; {size[1]}x{size[0]} is expected")
        elif mode != "RGB":
            lines.append(f"{name} has mode {mode}; 8-bit RGB is expected")
    return lines
