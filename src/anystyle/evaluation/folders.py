"""Any method's images in three folders: which photograph and which style each stylized image belongs to."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.capacity import require
from anystyle.data.images import SUFFIXES, image_size, open_image, to_tensor
from anystyle.documents import read_json
from anystyle.io.arrays import read_array, read_arrays
from anystyle.io.names import natural
from anystyle.types import Cameras, Comparison, Style

log = logging.getLogger(__name__)

DEPTH_SUFFIXES = frozenset({".npy"})
CAMERAS = "cameras.npz"
_CAMERAS = (
    "file of cameras: frames (names), world_from_camera [V, 4, 4], intrinsics [V, 3, 3] in pixels and size (height, "
    "width)"
)
_NUM_LISTED = 8
_LONGEST = 1 << 16

Files = dict[tuple[str, str], Path]
"""Files by scene and stem."""


@dataclass(frozen=True)
class Cell:
    """The stylized images of one scene in one style, in order of their frames.

    Args:
        scene: Its name; empty where the images lie in one flat folder.
        style: Its name.
        frames: Their names.
        content: The photograph of each.
        stylized: Their files.
        reference: The style image.
        depth: Of each, where there is depth.
        cameras: A file with the cameras of the frames, where there is one.
    """

    scene: str
    style: str
    frames: tuple[str, ...]
    content: tuple[Path, ...]
    stylized: tuple[Path, ...]
    reference: Path
    depth: tuple[Path, ...] = ()
    cameras: Path | None = None


@dataclass(frozen=True)
class Pairing:
    """What three folders hold.

    Args:
        cells: Every scene in every style.
        unused: Photographs and style images that no stylized image belongs to.
    """

    cells: tuple[Cell, ...]
    unused: tuple[str, ...] = ()

    def scenes(self) -> dict[str, list[Cell]]:
        """The cells of each scene."""
        scenes: dict[str, list[Cell]] = {}
        for cell in self.cells:
            scenes.setdefault(cell.scene, []).append(cell)
        return scenes


class _Match(NamedTuple):
    """A stylized image with what belongs to it."""

    frame: str
    content: Path
    stylized: Path
    reference: Path
    depth: Path | None


def pair(content: Path, style: Path, stylized: Path, depth: Path | None = None) -> Pairing:
    """Find the photograph and the style of each stylized image.

    Stylized images are ``SCENE/STYLE_FRAME.png`` or ``SCENE/STYLE/FRAME.png``, or ``STYLE_FRAME.png`` for one scene.
    Photographs are ``SCENE/FRAME.png`` (or ``FRAME.png``), styles ``STYLE.png``; either may also lie under the stylized
    image's own name, as published evaluations write them. Numbers are compared as numbers: frame ``3`` is frame
    ``003``. Depth, along z, is ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` beside it where cameras are known.

    Raises:
        ValueError: A folder is missing or empty, or a stylized image has no partner; the message lists them.
    """
    results = _files(stylized, "stylized", SUFFIXES)
    photographs, references = _files(content, "content", SUFFIXES), _files(style, "style", SUFFIXES)
    depths = {} if depth is None else _files(depth, "depth", DEPTH_SUFFIXES)
    by_content, by_style, by_depth = _by_number(photographs), _by_number(references), _by_number(depths)
    cells: dict[tuple[str, str], list[_Match]] = {}
    unmatched: list[str] = []
    for (scene, stem), path in results.items():
        name, _, frame = stem.rpartition("_")
        name, frame = (name, frame) if name else (stem, stem)
        # Under the stylized image's own name first: a triple of equal names leaves nothing to guess.
        photograph, reference = _lookup(by_content, scene, (stem, frame)), _lookup(by_style, scene, (stem, name))
        depth_map = _lookup(by_depth, scene, (frame, stem))
        if photograph is not None and reference is not None and (depth_map is not None or not depths):
            match = _Match(frame, photograph, path, reference, depth_map)
            cells.setdefault((scene, name), []).append(match)
            continue
        missing = [f"no content {frame}"] * (photograph is None) + [f"no style {name}"] * (reference is None)
        unmatched.append(f"{scene}/{stem} ({', '.join(missing) or f'no depth {frame}'})".lstrip("/"))
    if unmatched:
        raise ValueError(f"{len(unmatched)} of {len(results)} stylized images have no partner: {_listed(unmatched)}")
    matches = [match for rows in cells.values() for match in rows]
    used = {match.content for match in matches} | {match.reference for match in matches}
    unused = [_relative(path, content) for path in photographs.values() if path not in used]
    unused += [_relative(path, style) for path in references.values() if path not in used]
    if unused:
        log.warning("%d images belong to no stylized image: %s", len(unused), _listed(unused))
    order = sorted(cells, key=lambda key: (natural(key[0]), natural(key[1])))
    return Pairing(tuple(_cell(*key, cells[key], depth) for key in order), tuple(unused))


class Reader:
    """Reads cells as comparisons; the photographs of a scene are decoded once and stay the same tensor.

    Raises:
        ValueError: A file cannot be read, or sizes differ.
    """

    def __init__(self) -> None:
        self._content = lru_cache(1)(_read_stack)
        self._reference = lru_cache(256)(read)
        self._depth = lru_cache(1)(_read_depths)

    def __call__(self, cell: Cell) -> Comparison:
        """Everything of one cell, as a batch of one."""
        sizes = [image_size(path) for path in (*cell.stylized, *cell.content)]
        require(
            sum(width * height * 3 * (1 + 4 + 4) for width, height in sizes),
            f"{len(sizes)} images of {cell.scene} in {cell.style}, of up to {'x'.join(map(str, max(sizes)))}",
            "give fewer frames a scene, or smaller ones",
        )
        stylized, content = _read_stack(cell.stylized), self._content(cell.content)
        if stylized.shape[-2:] != content.shape[-2:]:
            raise ValueError(
                f"{cell.stylized[0]} has {_size(stylized)} pixels and its photograph {cell.content[0]} "
                f"{_size(content)}; give both in one size"
            )
        return Comparison(
            content=content,
            stylized=stylized,
            style=Style(image=self._reference(cell.reference)[None], names=(cell.style,)),
            depth=self._depth(cell.depth) if cell.depth else None,
            cameras=_read_cameras(cell, (stylized.shape[-2], stylized.shape[-1])),
            scenes=(cell.scene,),
            styles=(cell.style,),
            seconds=_read_seconds(cell),
        )


def read(path: Path) -> Float[Tensor, "3 H W"]:
    """An image at its own size, sRGB in [0, 1].

    Raises:
        ValueError: It cannot be read.
    """
    return to_tensor(open_image(path, longest=_LONGEST))


def _read_stack(paths: tuple[Path, ...]) -> Float[Tensor, "1 V 3 H W"]:
    images = [read(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != images[0].shape:
            raise ValueError(
                f"{path} has {_size(image)} pixels and {paths[0]} {_size(images[0])}; "
                "the images of one scene need one size"
            )
    return torch.stack(images)[None]


def _read_depths(paths: tuple[Path, ...]) -> Float[Tensor, "1 V H W"]:
    maps = []
    for path in paths:
        values = read_array(path, what="array of finite depth of shape [H, W]")
        if values.ndim != 2:
            raise ValueError(f"{path} has shape {list(values.shape)}; expected finite depth of shape [H, W]")
        if maps and values.shape != maps[0].shape:
            raise ValueError(f"{path} has another shape than {paths[0]}; the depth of one scene needs one size")
        maps.append(torch.from_numpy(values.astype(np.float32)))
    return torch.stack(maps)[None]


def _read_cameras(cell: Cell, size: tuple[int, int]) -> Cameras | None:
    if cell.cameras is None:
        return None
    arrays = read_arrays(cell.cameras, ("world_from_camera", "intrinsics", "size"), ("frames",), what=_CAMERAS)
    names, poses, intrinsics = arrays["frames"].tolist(), arrays["world_from_camera"], arrays["intrinsics"]
    shapes = (poses.shape, intrinsics.shape, arrays["size"].shape)
    if shapes != ((len(names), 4, 4), (len(names), 3, 3), (2,)) or not (arrays["size"] >= 1).all():
        raise ValueError(f"{cell.cameras} is no {_CAMERAS}")
    absent = [frame for frame in cell.frames if frame not in names]
    if absent:
        raise ValueError(f"{cell.cameras} does not hold the cameras of {cell.scene}: {absent[0]!r} is not in it")
    indices = [names.index(frame) for frame in cell.frames]
    height, width = (int(side) for side in arrays["size"])
    cameras = Cameras(
        torch.from_numpy(poses[indices].astype(np.float32))[None],
        torch.from_numpy(intrinsics[indices].astype(np.float32))[None],
        (height, width),
    )
    return cameras.resized(size)


def seconds_file(folder: Path, style: str) -> Path:
    """The file with the seconds that a scene's images in a style took; written when they are complete."""
    return folder / f".{style}"


class _Seconds(msgspec.Struct):
    seconds: Annotated[float, msgspec.Meta(ge=0)]


def read_seconds(path: Path) -> float:
    """What :func:`seconds_file` names holds.

    Raises:
        ValueError: It is damaged.
    """
    stored: _Seconds = read_json(path, _Seconds, what="file of seconds; delete it and evaluate again")
    return stored.seconds


def _read_seconds(cell: Cell) -> Float[Tensor, " B"] | None:
    path = seconds_file(cell.stylized[0].parent, cell.style)
    if not path.is_file():
        return None
    return torch.tensor([read_seconds(path)], dtype=torch.float32)


def write_cameras(path: Path, frames: Sequence[str], cameras: Cameras) -> None:
    """Write the cameras of one scene as :class:`Reader` reads them from beside depth maps."""
    with path.open("wb") as file:
        np.savez(
            file,
            frames=np.array(list(frames)),
            world_from_camera=cameras.world_from_camera[0].cpu().numpy(),
            intrinsics=cameras.intrinsics[0].cpu().numpy(),
            size=np.array(cameras.size),
        )


def _files(folder: Path, what: str, suffixes: frozenset[str]) -> Files:
    """Files by scene and stem, in natural order; ``SCENE/STYLE/FRAME.png`` has the stem ``STYLE_FRAME``."""
    if not folder.is_dir():
        raise ValueError(f"there is no {what} folder {folder}")
    paths = [path for path in folder.iterdir() if path.is_file()]
    for scene in (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        inside = scene / "images" if (scene / "images").is_dir() else scene
        paths += [path for path in inside.iterdir() if path.is_file()]
        if what == "stylized":
            paths += [path for path in inside.glob("*/*") if path.is_file() and not path.parent.name.startswith(".")]
    files: Files = {}
    for path in sorted(paths, key=lambda path: natural(path.relative_to(folder).as_posix())):
        if path.suffix.lower() not in suffixes or path.name.startswith("."):
            continue
        parts = path.relative_to(folder).parts
        inner = [part for part in parts[:-1] if part != "images"]
        key = (inner[0] if inner else "", "_".join([*inner[1:], path.stem]))
        if key in files:
            raise ValueError(f"{files[key]} and {path} are the same image of the {what} folder; keep one of them")
        files[key] = path
    if not files:
        raise ValueError(f"the {what} folder {folder} holds no {'depth (.npy)' if what == 'depth' else 'image'}")
    return files


def _key(name: str) -> str:
    return str(int(name)) if name.isascii() and name.isdecimal() and len(name) < 10 else name


def _by_number(files: Files) -> Files:
    return {(scene, _key(stem)): path for (scene, stem), path in files.items()}


def _lookup(files: Mapping[tuple[str, str], Path], scene: str, names: Iterable[str]) -> Path | None:
    """The first file of one of these names, in the scene's own folder or in none."""
    keys = [(folder, _key(name)) for name in names for folder in (scene, "")]
    return next((files[key] for key in keys if key in files), None)


def _cell(scene: str, style: str, matches: Sequence[_Match], depth: Path | None) -> Cell:
    matches = sorted(matches, key=lambda match: natural(match.frame))
    cameras = None if depth is None else depth / scene / CAMERAS
    return Cell(
        scene=scene,
        style=style,
        frames=tuple(match.frame for match in matches),
        content=tuple(match.content for match in matches),
        stylized=tuple(match.stylized for match in matches),
        reference=matches[0].reference,
        depth=tuple(match.depth for match in matches if match.depth is not None),
        cameras=cameras if cameras is not None and cameras.is_file() else None,
    )


def _relative(path: Path, root: Path) -> str:
    return f"{root.name}/{path.relative_to(root).as_posix()}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NUM_LISTED
    return ", ".join(names[:_NUM_LISTED]) + (f" and {more} more" if more > 0 else "")


def _size(image: Tensor) -> str:
    return f"{image.shape[-1]}x{image.shape[-2]}"
