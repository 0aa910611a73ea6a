"""``anystyle benchmark site``: judged results as a static site, which opens from a folder and from a server.

A cell's views lie below each other in one picture.
"""

import argparse
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from PIL import Image

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.data.images import open_image
from anystyle.errors import UserError
from anystyle.evaluation.tables import number
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import as_number
from anystyle.types import Progress
from anystyle_benchmark.judge import inputs_of
from anystyle_benchmark.results import FIGURES, CellFigures, Figures, Interval, read_figures
from anystyle_benchmark.statistics import cost, scene_cost
from anystyle_benchmark.track import Inputs

if TYPE_CHECKING:
    from jinja2 import Environment

PAGES = Path(__file__).parent / "pages"

_LONGEST = 65535  # pixels of a side that AVIF can hold
_STYLE = 512  # pixels of the longer side of a style image


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark site``."""
    flags = new_parser(
        "benchmark site",
        "Make a static site of judged results: tables, cost against quality, the pictures behind every score. It "
        "opens from its folder and from any server, and loads nothing from other addresses.",
    )
    add = flags.add_argument
    add("results", type=Path, help="the folder that `anystyle benchmark judge` judged")
    add("--out", type=Path, required=True, metavar="DIR", help="the site's folder")
    add("--track", metavar="NAME", help="a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    add("--quality", type=int, default=50, metavar="N", help="of its AVIF pictures, 1 to 100 (default %(default)s)")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark site``."""
    arguments = parse(parser(), args)
    if not 1 <= arguments.quality <= 100:
        raise UserError(f"--quality {arguments.quality}; give 1 to 100")
    root, figures = arguments.results, read_figures(arguments.results)
    inputs = inputs_of(root, arguments.track, arguments.root)
    if inputs.digest != figures.track.digest:
        raise UserError(
            f"{root / FIGURES} is of other inputs, or another version of track or judge; run "
            f"`anystyle benchmark judge {root}`"
        )
    shown = [_with_images(cell, root) for cell in pictured(figures.cells)]
    sources: dict[str, Sequence[Path]] = {
        f"cells/{cell.method}/{cell.scene}/{cell.style}.avif": [
            cell.cell.images(root) / f"{view}.png" for view in inputs.scene(cell.scene).views
        ]
        for cell in shown
        if cell.status == "done"
    }
    sources |= {f"styles/{one.name}.avif": [inputs.path(one.image)] for one in inputs.track.styles if one.image}
    entries = ("index.html", "site.css", "site.js", "figures.js", "cells", "styles")
    on_progress = progress_lines()
    with atomic_directory(arguments.out, entries) as folder:
        for name, text in pages(inputs, figures, shown).items():
            (folder / name).write_text(text, encoding="utf-8")
        for done, (name, files) in enumerate(sources.items(), 1):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(encode(files, arguments.quality))
            on_progress(Progress.count("site", done, len(sources)))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    print(f"{arguments.out / 'index.html'}: {size / 1e6:.1f} MB")


def pictured(cells: Sequence[CellFigures]) -> list[CellFigures]:
    """The cell of one seed for each method, scene and style: the first seed that has images."""
    found: dict[tuple[str, ...], CellFigures] = {}
    for cell in sorted(cells, key=lambda cell: (cell.status != "done", cell.seed)):
        found.setdefault((cell.method, *cell.place), cell)
    return list(found.values())


def _with_images(cell: CellFigures, root: Path) -> CellFigures:
    """The cell, marked where it was judged elsewhere (``judge --beside``) and its images are not here."""
    if cell.status != "done" or cell.cell.images(root).is_dir():
        return cell
    return msgspec.structs.replace(cell, status="missing", message=f"its images are not in {root.name}")


def pages(inputs: Inputs, figures: Figures, shown: Sequence[CellFigures]) -> dict[str, str]:
    """The files of the site that are text."""
    values = {
        "figures": figures,
        "track": inputs.track,
        "track_word": inputs.track.name if inputs.bundled else inputs.file.name,
        "track_flag": "" if inputs.bundled else f" --track {inputs.file.name}",
        "specs": figures.methods,
        "headline": figures.headline,
        "guides": {guide: _rows(figures, guide) for guide in dict.fromkeys(row.guide for row in figures.table)},
        "taken": {name: _taken(figures, name) for name in figures.methods},
    }
    data = json.dumps(_data(inputs, figures, shown), ensure_ascii=False, separators=(",", ":"))
    return {
        "index.html": _templates().get_template("index.html").render(values),
        **{name: (PAGES / name).read_text(encoding="utf-8") for name in ("site.css", "site.js")},
        "figures.js": f"const RESULTS = {data};\n",
    }


def _templates() -> "Environment":
    from jinja2 import Environment, FileSystemLoader

    environment = Environment(loader=FileSystemLoader(PAGES), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["address"] = lambda text: text.startswith(("https://", "http://"))
    environment.filters["number"] = number
    return environment


def _rows(figures: Figures, guide: str) -> list[dict[str, Any]]:
    """The rows of a guide's table; bars span the intervals of methods, as baselines may be far off."""
    rows = [row for row in figures.table if row.guide == guide]
    methods = [row for row in rows if not figures.methods[row.method].baseline] or rows
    spans: dict[str, tuple[float, float]] = {}
    for name in figures.metrics:
        intervals = [row.figures[name] for row in methods if name in row.figures]
        ends = [as_number(value) for one in intervals for value in (one.low, one.mean, one.high)]
        known = list(filter(math.isfinite, ends))
        spans[name] = min(known, default=0), max(known, default=0)
    return [
        {
            "method": row.method,
            "spec": figures.methods[row.method],
            "cells": row.cells,
            "failed": row.failed,
            "seconds": cost(figures.cells_of(row.method, guide)),
            "drawn": {name: _drawn(row.figures.get(name), *span) for name, span in spans.items()},
        }
        for row in rows
    ]


def _drawn(one: Interval | None, first: float, last: float) -> dict[str, Any] | None:
    """A mean with its interval, and where low, mean and high lie in the column, from 0 to 100."""
    if one is None or one.mean is None:
        return None
    mean, low, high = (as_number(value) for value in (one.mean, one.low, one.high))
    ends = [mean if math.isnan(value) else value for value in (low, mean, high)]
    drawable = math.isfinite(mean) and last > first
    bar = tuple(100 * min(max((end - first) / (last - first), 0), 1) for end in ends) if drawable else None
    return {"mean": mean, "low": low, "high": high, "bar": bar}


def _taken(figures: Figures, method: str) -> dict[str, Any]:
    """What a method took: seconds by guide and once per scene, memory, and where it ran."""
    cells = [cell for cell in figures.cells if cell.method == method]
    origins = [figures.origins[cell.origin] for cell in cells if cell.origin in figures.origins]
    guides = dict.fromkeys(cell.guide for cell in cells)
    return {
        "seconds": {guide: cost(figures.cells_of(method, guide)) for guide in guides},
        "once": scene_cost(cells),
        "memory": max((cell.memory for cell in cells if cell.memory is not None), default=None),
        "codes": sorted({origin.code for origin in origins if origin.code}),
        "machines": sorted({origin.machine for origin in origins if origin.machine}),
        "versions": {name: version for origin in origins for name, version in origin.versions.items()},
    }


def _data(inputs: Inputs, figures: Figures, shown: Sequence[CellFigures]) -> dict[str, Any]:
    """JSON embedded for ``site.js``."""
    cells: dict[str, dict[str, Any]] = {name: {} for name in figures.methods}
    for cell in shown:
        said = {key: getattr(cell, key) for key in ("status", "message", "figures")}
        cells[cell.method]["/".join(cell.place)] = said
    wholes = {  # the first seed's stay
        f"{whole.method}/{whole.scene}/{whole.guide}": whole.figures
        for whole in sorted(figures.scenes, key=lambda whole: -whole.seed)
    }
    described = ("title", "consistent", "baseline", "seeds")
    scenes, styles = inputs.track.scenes, inputs.track.styles
    return {
        "scenes": {one.name: {"views": len(one.views), "size": inputs.size(one)[::-1]} for one in scenes},
        "styles": {one.name: {"title": one.text or one.title or one.name, "guide": one.guide} for one in styles},
        "metrics": {name: {"title": info.title, "better": info.better} for name, info in figures.metrics.items()},
        "methods": {name: {key: getattr(spec, key) for key in described} for name, spec in figures.methods.items()},
        "cells": cells,
        "wholes": wholes,
    }


def encode(pictures: Sequence[Path], quality: int) -> bytes:
    """Pictures of one size below each other, as AVIF; they begin at blocks of 16 pixels, to mix less."""
    views = [open_image(path) for path in pictures]
    scale = min(1, _LONGEST / (len(views) * views[0].height), _STYLE / max(views[0].size) if len(views) == 1 else 1)
    block = 16 if len(views) > 1 else 1
    width, height = max(1, int(views[0].width * scale)), block * max(1, int(views[0].height * scale / block))
    strip = Image.new("RGB", (width, height * len(views)))
    for index, view in enumerate(views):
        strip.paste(view.resize((width, height), Image.Resampling.LANCZOS), (0, index * height))
    data = io.BytesIO()
    strip.save(data, "AVIF", quality=quality, speed=10)  # speed 6: a tenth smaller, in ten times the time
    return data.getvalue()
