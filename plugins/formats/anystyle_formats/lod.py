"""Streamed SOG: a folder with the scene in levels of detail and all styles, and a page that loads it in parts.

The format is described in PlayCanvas's user manual (developer.playcanvas.com, "The Streamed SOG Format", version 1).
The leaves of a k-d tree hold runs of Gaussians in chunks of each level, and every chunk is an unbundled SOG scene.
All styles share their images of positions, sizes and rotations.
"""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import parse_json, read_bytes, regular
from anystyle.io.splats import near
from anystyle.paths import natural
from anystyle.pipeline.styles import slug
from anystyle.types import StyledScene
from anystyle_formats.html import page_of
from anystyle_formats.levels import Level, levels_of
from anystyle_formats.packing import Columns, columns_of
from anystyle_formats.reading import gaussians, reading, room_for
from anystyle_formats.sog import asset, decoded, encoded_colors, encoded_shape, notes_of


class Lod(Format):
    """Streamed SOG in all styles: ``lod-meta.json`` is the last, ``styles`` has the others, ``index.html`` the page."""

    index = "lod-meta.json"
    has_notes = many_styles = reads = True
    shared = ("means", "rotations", "scales", "opacities")

    def write(self, scene: StyledScene, path: Path) -> None:
        styles = [columns_of(scene.splats(index)) for index in range(len(scene.styles))]
        harmonics = [style.harmonics for style in styles]
        # Those of all styles are merged as if they were one.
        levels = levels_of(styles[-1]._replace(harmonics=np.concatenate(harmonics, 1)))
        ends = np.cumsum([each.shape[1] for each in harmonics])[:-1]
        titles = [title for title, _ in scene.styles]
        folders = [f"styles/{number}-{slug(title)}/" for number, title in enumerate(titles[:-1], 1)] + [""]
        index = index_of(levels)
        page = page_of(scene, {"rotations": [0]}, [{"rotation": 0, "folder": folder} for folder in folders])
        chunks: list[Future[None]] = []
        with atomic_directory(path, overwrite=True) as target, ThreadPoolExecutor() as pool:  # WebP lets threads run
            for number, level in enumerate(levels):
                for chunk, (start, end) in enumerate(pairwise(level.runs[:: level.step])):
                    part = Columns(*(column[start:end] for column in level.columns))
                    colors = zip(folders, np.split(part.harmonics, ends, 1), strict=True)
                    chunks.append(pool.submit(_write_chunk, target, f"{number}_{chunk}", part, dict(colors)))
            for each in chunks:
                each.result()
            for folder, title in zip(folders, titles, strict=True):
                about = {"asset": asset(scene.notes) | {"title": title}}
                (target / folder / self.index).write_text(json.dumps(index | about), encoding="utf-8")
            (target / "index.html").write_text(page, encoding="utf-8", errors="backslashreplace")

    def read(self, path: Path) -> StyledScene:
        """Read each leaf of the tree in its finest level, and what is always shown; the styles are those below it."""
        files = sorted(path.glob(f"styles/*/{self.index}"), key=lambda file: natural(file.parent.name))
        files.append(path / self.index)
        with reading(files[-1], "index of streamed SOG") as remarks:
            found = [_finest(file) for file in files]
            titles = [index.get("asset", {}).get("title", file.parent.resolve().stem) for file, index, _ in found]
            placed = [(near(columns.means, remarks), columns) for _, _, columns in found]
            read = [gaussians(remarks, means, *columns[1:]) for (means, _), columns in placed]
            notes = notes_of(found[-1][1])
        return StyledScene(tuple(zip(map(str, titles), read, strict=True)), notes=notes, offset=placed[-1][0][1])


def _finest(file: Path) -> tuple[Path, dict[str, Any], Columns]:
    """An index and its content, and the Gaussians of each leaf in the finest of its levels."""
    index = parse_json(read_bytes(file), dict[str, Any], source=str(file), what="index of streamed SOG")
    nodes, runs = [index["tree"]], defaultdict[str, list[NDArray[np.int64]]](list)
    while nodes:
        node = nodes.pop()
        nodes += reversed(node.get("children") or [])
        if lods := node.get("lods"):
            place = lods[min(lods, key=int)]
            room_for(file, place["count"])
            rows = np.arange(place["offset"], place["offset"] + place["count"])
            runs[index["filenames"][place["file"]]].append(rows)
    parts: list[Columns] = []
    for name in (*runs, *filter(None, [index.get("environment")])):
        part = decoded(lambda image: regular(file.parent / image, most=None).read_bytes(), name, file)[1]
        rows = np.concatenate(runs[name]) if name in runs else slice(None)
        parts.append(Columns(*(column[rows] for column in part)))
    most = max(part.harmonics.shape[1] for part in parts)
    padded = [
        part._replace(harmonics=np.pad(part.harmonics, ((0, 0), (0, most - part.harmonics.shape[1]), (0, 0))))
        for part in parts
    ]
    return file, index, Columns(*(np.concatenate(columns) for columns in zip(*padded, strict=True)))


def index_of(levels: Sequence[Level]) -> dict[str, Any]:
    """``lod-meta.json`` but for what it says of the scene."""
    low, high = np.stack([level.bounds for level in levels]).swapaxes(0, 1)  # levels L 3 each
    files = [(number, leaf) for number, level in enumerate(levels) for leaf in range(0, low.shape[1], level.step)]
    nodes: list[dict[str, Any]] = []
    for leaf in range(low.shape[1]):
        lods = {}
        for number, level in enumerate(levels):
            first, (start, end) = leaf - leaf % level.step, level.runs[leaf : leaf + 2]
            place = {"file": files.index((number, first)), "offset": start - level.runs[first], "count": end - start}
            lods[str(number)] = place
        bound = {"min": low[:, leaf].min(0).tolist(), "max": high[:, leaf].max(0).tolist()}
        nodes.append({"bound": bound, "lods": lods})
    while len(nodes) > 1:
        nodes = [_parent(*pair) for pair in zip(nodes[::2], nodes[1::2], strict=True)]
    counts = [len(level.leaf) for level in levels]
    return {
        "version": 1,
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(levels),
        "filenames": [f"{number}_{leaf // levels[number].step}/meta.json" for number, leaf in files],
        "tree": nodes[0],
    }


def _parent(*nodes: dict[str, Any]) -> dict[str, Any]:
    low, high = (np.stack([node["bound"][end] for node in nodes]) for end in ("min", "max"))
    return {"bound": {"min": low.min(0).tolist(), "max": high.max(0).tolist()}, "children": list(nodes)}


def _write_chunk(folder: Path, name: str, part: Columns, colors: Mapping[str, NDArray[np.float64]]) -> None:
    """A chunk in all styles, by their folders; the images of its geometry are in that of the last."""
    shape, shared = encoded_shape(part)
    about = {"version": 2, "asset": {"generator": "anystyle"}, "count": len(part.means), "antialias": False}
    for inside, harmonics in colors.items():
        here = "../" * (inside.count("/") + 1) + f"{name}/" if inside else ""
        named = {key: {**value, "files": [here + file for file in value["files"]]} for key, value in shape.items()}
        meta, images = encoded_colors(part._replace(harmonics=harmonics))
        target = folder / inside / name
        target.mkdir(parents=True)
        (target / "meta.json").write_text(json.dumps({**about, **named, **meta}), encoding="utf-8")
        for file, data in {**images, **({} if inside else shared)}.items():
            (target / file).write_bytes(data)
