"""A static site of a benchmark's figures and the pictures behind them: it opens from a folder and from a server.

A cell's views lie below each other in one picture, so that a slider moves them without loading anything.
"""

import io
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

from anystyle.data.images import open_image
from anystyle.errors import UserError
from anystyle.evaluation.tables import number
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import Figure, as_number, fit, kept_json
from anystyle.types import OnProgress, Progress
from anystyle_benchmark.command_judge import cost, scene_cost
from anystyle_benchmark.judge import photographs
from anystyle_benchmark.results import Cell, CellFigures, Figures, Interval, Record, TableRow
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.track import Inputs

PAGES = Path(__file__).parent / "pages"
QUALITIES = (
    *((1, 75), (1, 65), (1, 55), (1, 45), (1, 40), (1, 35), (0.92, 35), (0.85, 35), (0.75, 35), (0.65, 35)),
    *((0.55, 35), (0.45, 35), (0.35, 35), (0.25, 30), (0.2, 25)),
)
"""Scale and AVIF quality of the pictures, best first."""
_SAMPLE = 24  # pictures from which the size at a quality is estimated
_LONGEST = 65535  # pixels of a side that AVIF can hold
_STYLE = 512  # pixels of the longer side of a style image


class Made(NamedTuple):
    """The site's size, and the scale and quality that its pictures have."""

    size: int
    scale: float
    quality: int


class Drawn(NamedTuple):
    """A table's cell: a mean with its interval, and where low, mean and high lie in the column, from 0 to 100."""

    mean: float
    low: float
    high: float
    bar: tuple[float, ...] | None


def build(inputs: Inputs, root: Path, figures: Figures, out: Path, megabytes: float, on_progress: OnProgress) -> Made:
    """Write the site of judged results.

    Args:
        inputs: The track.
        root: The folder of results.
        figures: What the judge found there.
        out: The site's folder.
        megabytes: How large it may be, in 10^6 bytes; pictures are as good as that allows.
        on_progress: Called for every picture.
    """
    specs: dict[str, Spec] = {
        name: fit(spec, Spec, source=f"{root}: {name}", what="spec of a method")
        for name, spec in figures.methods.items()
    }
    shown = pictured(figures.cells)
    sources: dict[str, Sequence[Path]] = {
        f"cells/{cell.method}/{cell.scene}/{cell.style}.avif": [
            _place(cell).images(root) / f"{view}.png" for view in inputs.scene(cell.scene).views
        ]
        for cell in shown
        if cell.status == "done"
    }
    sources |= {f"photographs/{one.name}.avif": photographs(inputs, one, root) for one in inputs.track.scenes}
    sources |= {f"styles/{one.name}.avif": [inputs.path(one.image)] for one in inputs.track.styles if one.image}
    entries = ("index.html", "compare.html", "site.css", "site.js", "figures.js", "cells", "photographs", "styles")
    with atomic_directory(out, entries) as folder:
        for name, text in pages(inputs, root, figures, specs, shown).items():
            (folder / name).write_text(text, encoding="utf-8")
        for cell in shown:
            if (page := _place(cell).page(root)).is_file():
                target = folder / "cells" / cell.method / cell.scene / page.name
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(page, target)
        return _write(sources, folder, megabytes, on_progress)


def pictured(cells: Sequence[CellFigures]) -> list[CellFigures]:
    """The cell of one seed for each method, scene and style: the first seed that has images."""
    found: dict[tuple[str, ...], CellFigures] = {}
    for cell in sorted(cells, key=lambda cell: (cell.status != "done", cell.seed)):
        found.setdefault((cell.method, *cell.place), cell)
    return list(found.values())


def encode(pictures: Sequence[Path], scale: float, quality: int) -> bytes:
    """Pictures of one size below each other, as AVIF; they begin at blocks of 16 pixels, to mix less."""
    views = [open_image(path) for path in pictures]
    scale = min(scale, _LONGEST / (len(views) * views[0].height), _STYLE / max(views[0].size) if len(views) == 1 else 1)
    block = 16 if len(views) > 1 else 1
    width, height = max(1, int(views[0].width * scale)), block * max(1, int(views[0].height * scale / block))
    strip = Image.new("RGB", (width, height * len(views)))
    for index, view in enumerate(views):
        strip.paste(view.resize((width, height), Image.Resampling.LANCZOS), (0, index * height))
    data = io.BytesIO()
    strip.save(data, "AVIF", quality=quality, speed=10)  # speed 6: a tenth smaller, in ten times the time
    return data.getvalue()


def pages(
    inputs: Inputs, root: Path, figures: Figures, specs: Mapping[str, Spec], shown: Sequence[CellFigures]
) -> dict[str, str]:
    """The files of the site that are text."""
    from jinja2 import Environment, FileSystemLoader

    firsts = {info.metric or name: name for name, info in reversed(figures.metrics.items())}
    headline = [name for name in figures.metrics if name in firsts.values()]
    environment = Environment(loader=FileSystemLoader(PAGES), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["address"] = lambda text: text.startswith(("https://", "http://"))
    environment.filters["number"] = number
    words = {
        "figures": figures,
        "track": inputs.track,
        "track_word": inputs.track.name if inputs.bundled else inputs.file.name,
        "track_flag": "" if inputs.bundled else f" --track {inputs.file.name}",
        "specs": specs,
        "headline": headline,
        "guides": {guide: _rows(figures, specs, guide) for guide in dict.fromkeys(row.guide for row in figures.table)},
        "taken": {name: _taken(root, figures, name) for name in specs},
    }
    data = json.dumps(_data(inputs, root, figures, specs, shown, headline), ensure_ascii=False, separators=(",", ":"))
    return {
        **{name: environment.get_template(name).render(words) for name in ("index.html", "compare.html")},
        **{name: (PAGES / name).read_text(encoding="utf-8") for name in ("site.css", "site.js")},
        "figures.js": f"const RESULTS = {data};\n",
    }


def _rows(figures: Figures, specs: Mapping[str, Spec], guide: str) -> list[dict[str, Any]]:
    """The rows of a guide's table."""
    rows = [row for row in figures.table if row.guide == guide]
    ranges = {name: _range(name, rows, specs) for name in figures.metrics}
    return [
        {
            "method": row.method,
            "spec": specs[row.method],
            "cells": row.cells,
            "failed": row.failed,
            "seconds": cost([cell for cell in figures.cells if (cell.method, cell.guide) == (row.method, guide)]),
            "drawn": {name: _drawn(row.figures.get(name), ranges[name]) for name in figures.metrics},
        }
        for row in rows
    ]


def _range(name: str, rows: Sequence[TableRow], specs: Mapping[str, Spec]) -> tuple[float, float]:
    """What a column's bars span: intervals of methods; of baselines, which may be far off, if there are no others."""
    methods = [row for row in rows if not specs[row.method].baseline] or rows
    ends = [
        as_number(value)
        for row in methods
        if (one := row.figures.get(name)) is not None
        for value in (one.low, one.mean, one.high)
    ]
    known = [value for value in ends if math.isfinite(value)]
    return min(known, default=0), max(known, default=0)


def _drawn(one: Interval | None, span: tuple[float, float]) -> Drawn | None:
    if one is None or one.mean is None:
        return None
    mean, low, high = (as_number(value) for value in (one.mean, one.low, one.high))
    ends = [mean if math.isnan(value) else value for value in (low, mean, high)]
    width = span[1] - span[0]
    drawable = math.isfinite(mean) and width > 0
    bar = tuple(100 * min(max((value - span[0]) / width, 0), 1) for value in ends) if drawable else None
    return Drawn(mean, low, high, bar)


def _taken(root: Path, figures: Figures, method: str) -> dict[str, Any]:
    """What a method took: seconds by guide and once a scene, memory, and where it ran."""
    cells = [cell for cell in figures.cells if cell.method == method]
    records = [record for cell in cells if (record := kept_json(_place(cell).record(root), Record)) is not None]
    guides = dict.fromkeys(cell.guide for cell in cells)
    return {
        "seconds": {guide: cost([cell for cell in cells if cell.guide == guide]) for guide in guides},
        "once": scene_cost(cells),
        "memory": max((cell.memory for cell in cells if cell.memory is not None), default=None),
        "machines": sorted({record.machine for record in records if record.machine}),
        "versions": {name: version for record in records for name, version in record.versions.items()},
    }


def _data(
    inputs: Inputs,
    root: Path,
    figures: Figures,
    specs: Mapping[str, Spec],
    shown: Sequence[CellFigures],
    headline: Sequence[str],
) -> dict[str, Any]:
    """What the script reads."""
    cells: dict[str, dict[str, Any]] = {name: {} for name in specs}
    for cell in shown:
        cells[cell.method]["/".join(cell.place)] = {
            "seed": cell.seed,
            "status": cell.status,
            "message": cell.message,
            "figures": cell.figures,
            "page": _place(cell).page(root).is_file(),
        }
    wholes: dict[str, dict[str, Figure]] = {}
    for whole in sorted(figures.scenes, key=lambda whole: -whole.seed):  # the first seed's stay
        wholes[f"{whole.method}/{whole.scene}/{whole.guide}"] = whole.figures
    described = ("title", "guides", "consistent", "baseline", "seeds")
    return {
        "scenes": {
            one.name: {"title": one.title or one.name, "views": one.views, "size": inputs.size(one)[::-1]}
            for one in inputs.track.scenes
        },
        "styles": {
            one.name: {"title": one.title or one.text or one.name, "guide": one.guide, "text": one.text}
            for one in inputs.track.styles
        },
        "metrics": {
            name: {"title": info.title, "better": info.better, "headline": name in headline}
            for name, info in figures.metrics.items()
        },
        "methods": {name: {key: getattr(spec, key) for key in described} for name, spec in specs.items()},
        "cells": cells,
        "wholes": wholes,
    }


def _place(cell: CellFigures) -> Cell:
    return Cell(cell.method, cell.seed, cell.scene, cell.style)


def _write(sources: Mapping[str, Sequence[Path]], folder: Path, megabytes: float, on_progress: OnProgress) -> Made:
    """Write the pictures in the best quality in which the folder is not larger than allowed."""
    most, others = megabytes * 1e6, _size(folder)
    sample = list(sources.values())[:: max(1, len(sources) // _SAMPLE)]
    for scale, quality in QUALITIES:
        estimate = others + len(sources) / len(sample) * sum(len(encode(paths, scale, quality)) for paths in sample)
        if estimate > most:
            continue
        for done, (name, paths) in enumerate(sources.items()):
            on_progress(Progress.count("site", done, len(sources)))
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(encode(paths, scale, quality))
        on_progress(Progress.count("site", len(sources), len(sources)))
        if (size := _size(folder)) <= most:
            return Made(size, scale, quality)
    raise UserError(
        f"{len(sources)} pictures and {others / 1e6:.1f} MB of pages do not fit in {megabytes:g} MB; raise --megabytes"
    )


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
