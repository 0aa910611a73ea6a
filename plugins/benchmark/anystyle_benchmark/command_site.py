"""``anystyle benchmark site``: judged results as a static site, which opens from a folder and from a server.

A cell's views lie below each other in one picture, so that a slider moves them without loading anything.
"""

import argparse
import io
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from PIL import Image

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.data.images import open_image
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import as_number
from anystyle.types import OnProgress, Progress
from anystyle_benchmark.judge import inputs_of, photographs
from anystyle_benchmark.ladder import bundled
from anystyle_benchmark.ladder_page import ladder_page
from anystyle_benchmark.results import FIGURES, CellFigures, Figures, Interval, read_figures
from anystyle_benchmark.statistics import cost, scene_cost
from anystyle_benchmark.templates import PAGES, templates
from anystyle_benchmark.track import Inputs

QUALITIES = (
    *((1, 75), (1, 65), (1, 55), (1, 45), (1, 40), (1, 35), (0.92, 35), (0.85, 35), (0.75, 35), (0.65, 35)),
    *((0.55, 35), (0.45, 35), (0.35, 35), (0.25, 30), (0.2, 25)),
)
"""Scale and AVIF quality of the pictures, best first."""
_SAMPLE = 24  # pictures from which the size at a quality is estimated
_LONGEST = 65535  # pixels of a side that AVIF can hold
_STYLE = 512  # pixels of the longer side of a style image


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark site``."""
    flags = new_parser(
        "benchmark site",
        "Make a static site of judged results: tables, cost against quality, every cell's pictures side by side. It "
        "opens from its folder and from any server, and loads nothing from other addresses.",
    )
    add = flags.add_argument
    add("results", type=Path, help="the folder that `anystyle benchmark judge` judged")
    add("--out", type=Path, required=True, metavar="DIR", help="the site's folder")
    add("--track", metavar="NAME", help="a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    most = "the site's largest size; sets the quality of its pictures (default %(default)s)"
    add("--megabytes", type=float, default=60, metavar="N", help=most)
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark site``."""
    arguments = parse(parser(), args)
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
    sources |= {f"photographs/{one.name}.avif": photographs(inputs, one, root) for one in inputs.track.scenes}
    sources |= {f"styles/{one.name}.avif": [inputs.path(one.image)] for one in inputs.track.styles if one.image}
    pages_of_it = ("index.html", "compare.html", "ladder.html", "site.css", "site.js", "figures.js")
    entries = (*pages_of_it, "cells", "photographs", "styles")
    with atomic_directory(arguments.out, entries) as folder:
        for name, text in pages(inputs, root, figures, shown).items():
            (folder / name).write_text(text, encoding="utf-8")
        for cell in shown:
            if (page := cell.cell.page(root)).is_file():
                target = folder / "cells" / cell.method / cell.scene / page.name
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(page, target)
        made = write_pictures(sources, folder, arguments.megabytes, progress_lines())
    print(f"{arguments.out / 'index.html'}: {made}")


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


def pages(inputs: Inputs, root: Path, figures: Figures, shown: Sequence[CellFigures]) -> dict[str, str]:
    """The files of the site that are text."""
    environment, ladder = templates(), bundled(inputs.file.parent, figures)
    values = {
        "ladder": ladder,
        "figures": figures,
        "track": inputs.track,
        "track_word": inputs.track.name if inputs.bundled else inputs.file.name,
        "track_flag": "" if inputs.bundled else f" --track {inputs.file.name}",
        "specs": figures.methods,
        "headline": figures.headline,
        "guides": {guide: _rows(figures, guide) for guide in dict.fromkeys(row.guide for row in figures.table)},
        "taken": {name: _taken(figures, name) for name in figures.methods},
    }
    data = json.dumps(_data(inputs, root, figures, shown), ensure_ascii=False, separators=(",", ":"))
    return {
        **{name: environment.get_template(name).render(values) for name in ("index.html", "compare.html")},
        **({} if ladder is None else {"ladder.html": ladder_page(ladder)}),
        **{name: (PAGES / name).read_text(encoding="utf-8") for name in ("site.css", "site.js")},
        "figures.js": f"const RESULTS = {data};\n",
    }


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


def _data(inputs: Inputs, root: Path, figures: Figures, shown: Sequence[CellFigures]) -> dict[str, Any]:
    """JSON embedded for ``site.js``."""
    cells: dict[str, dict[str, Any]] = {name: {} for name in figures.methods}
    for cell in shown:
        said = {key: getattr(cell, key) for key in ("seed", "status", "message", "figures")}
        cells[cell.method]["/".join(cell.place)] = {**said, "page": cell.cell.page(root).is_file()}
    wholes = {  # the first seed's stay
        f"{whole.method}/{whole.scene}/{whole.guide}": whole.figures
        for whole in sorted(figures.scenes, key=lambda whole: -whole.seed)
    }
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
            name: {"title": info.title, "better": info.better, "headline": name in figures.headline}
            for name, info in figures.metrics.items()
        },
        "methods": {name: {key: getattr(spec, key) for key in described} for name, spec in figures.methods.items()},
        "cells": cells,
        "wholes": wholes,
    }


def write_pictures(
    sources: Mapping[str, Sequence[Path]], folder: Path, megabytes: float, on_progress: OnProgress
) -> str:
    """Write the pictures in the best quality in which the folder is not larger than allowed; what that is."""
    most, others = megabytes * 1e6, _size(folder)
    sample = list(sources.values())[:: max(1, len(sources) // _SAMPLE)]
    for scale, quality in QUALITIES:
        estimate = others + len(sources) / len(sample) * sum(len(encode(paths, scale, quality)) for paths in sample)
        if not estimate <= most:
            continue
        for done, (name, paths) in enumerate(sources.items()):
            on_progress(Progress.count("site", done, len(sources)))
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(encode(paths, scale, quality))
        on_progress(Progress.count("site", len(sources), len(sources)))
        if (size := _size(folder)) <= most:
            return f"{size / 1e6:.1f} MB, pictures at {scale:.0%} of their size in AVIF quality {quality}"
    raise UserError(
        f"{len(sources)} pictures and {others / 1e6:.1f} MB of pages do not fit in {megabytes:g} MB; raise --megabytes"
    )


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


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
