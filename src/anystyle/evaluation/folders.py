"""Any method's images in three folders: which photograph and which style each stylized image belongs to."""

import json
import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.folder import natural
from anystyle.data.images import SUFFIXES, open_image, to_tensor
from anystyle.data.latest import Latest
from anystyle.types import Cameras, Comparison, Style

log = logging.getLogger(__name__)

DEPTH_SUFFIXES = frozenset({".npy"})
CAMERAS = "cameras.npz"
_SHOWN = 8
_WHOLE = 1 << 16


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
        found: dict[str, list[Cell]] = {}
        for cell in self.cells:
            found.setdefault(cell.scene, []).append(cell)
        return found


def pair(content: Path, style: Path, stylized: Path, depth: Path | None = None) -> Pairing:
    """Find the photograph and the style of each stylized image.

    Stylized images are ``SCENE/STYLE_FRAME.png``, or ``STYLE_FRAME.png`` for one scene. Photographs are
    ``SCENE/FRAME.png`` (or ``FRAME.png``), styles ``STYLE.png``; either may also lie under the stylized image's own
    name, as published evaluations write them. Numbers are compared as numbers: frame ``3`` is frame ``003``. Depth is
    ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` beside it where cameras are known.

    Args:
        content: A folder of photographs.
        style: A folder of style images.
        stylized: A folder of results.
        depth: A folder of depth maps, distance along z; ``None`` for none.

    Raises:
        ValueError: A folder is missing or empty, or a stylized image has no partner; the message lists them.
    """
    results = _images(stylized, "stylized")
    photographs, references = _images(content, "content"), _images(style, "style")
    depths = {} if depth is None else _files(depth, "depth", DEPTH_SUFFIXES)
    by_content, by_style = _index(photographs), _index(references)
    by_depth = _index(depths)
    rows: dict[tuple[str, str], list[tuple[str, Path, Path, Path, Path | None]]] = {}
    lonely: list[str] = []
    used: set[Path] = set()
    for scene, stem in results:
        found = _partners(scene, stem, by_content, by_style)
        name = f"{scene}/{stem}".lstrip("/")
        if isinstance(found, str):
            lonely.append(f"{name} ({found})")
            continue
        style_name, frame, photograph, reference = found
        far = _lookup(by_depth, scene, (frame, stem)) if depths else None
        if depths and far is None:
            lonely.append(f"{name} (no depth {frame})")
            continue
        used |= {photograph, reference}
        rows.setdefault((scene, style_name), []).append((frame, photograph, reference, results[scene, stem], far))
    if lonely:
        raise ValueError(f"{len(lonely)} of {len(results)} stylized images have no partner: {_listed(lonely)}")
    unused = [_named(path, content) for path in photographs.values() if path not in used]
    unused += [_named(path, style) for path in references.values() if path not in used]
    if unused:
        log.warning("%d images belong to no stylized image: %s", len(unused), _listed(unused))
    cells = [_cell(scene, name, rows[scene, name], depth) for scene, name in sorted(rows, key=_natural_pair)]
    return Pairing(tuple(cells), tuple(unused))


class Reader:
    """Reads cells as comparisons; the photographs of a scene are decoded once, and stay the same tensor.

    Raises:
        ValueError: A file cannot be read, or sizes differ.
    """

    def __init__(self) -> None:
        self._content = Latest(_read_stack, 1)
        self._reference = Latest(read, 256)
        self._depth = Latest(_read_depths, 1)

    def __call__(self, cell: Cell) -> Comparison:
        """Everything of one cell, as a batch of one."""
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
    """An image as it is, sRGB in [0, 1].

    Raises:
        ValueError: It cannot be read.
    """
    return to_tensor(open_image(path, longest=_WHOLE))


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
    found = []
    for path in paths:
        try:
            values = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise ValueError(f"{path} is no array of depth ({str(error).splitlines()[0]})") from None
        if values.ndim != 2 or not np.isfinite(values).all():
            raise ValueError(f"{path} has shape {list(values.shape)}; expected finite depth of shape [H, W]")
        found.append(torch.from_numpy(values.astype(np.float32)))
    return torch.stack(found)[None]


def _read_cameras(cell: Cell, size: tuple[int, int]) -> Cameras | None:
    if cell.cameras is None:
        return None
    try:
        with np.load(cell.cameras, allow_pickle=False) as stored:
            names = [str(name) for name in stored["frames"]]
            poses, lenses = stored["world_from_camera"], stored["intrinsics"]
            places = [names.index(frame) for frame in cell.frames]
            height, width = (int(side) for side in stored["size"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise ValueError(
            f"{cell.cameras} does not hold the cameras of {cell.scene} ({str(error).strip(chr(39))}); expected frames "
            "(names), world_from_camera [V, 4, 4], intrinsics [V, 3, 3] in pixels and size (height, width)"
        ) from None
    cameras = Cameras(
        torch.from_numpy(poses[places].astype(np.float32))[None],
        torch.from_numpy(lenses[places].astype(np.float32))[None],
        (height, width),
    )
    return cameras.resized(size)


def mark(folder: Path, style: str) -> Path:
    """The file that says that a scene's images in a style are complete, and how long they took."""
    return folder / f".{style}"


def _read_seconds(cell: Cell) -> Float[Tensor, " B"] | None:
    path = mark(cell.stylized[0].parent, cell.style)
    if not path.is_file():
        return None
    return torch.tensor([json.loads(path.read_text(encoding="utf-8"))["seconds"]], dtype=torch.float32)


def write_cameras(path: Path, frames: Sequence[str], cameras: Cameras) -> None:
    """Write the cameras of one scene so that :class:`Reader` finds them beside depth."""
    with path.open("wb") as file:
        np.savez(
            file,
            frames=np.array(list(frames)),
            world_from_camera=cameras.world_from_camera[0].cpu().numpy(),
            intrinsics=cameras.intrinsics[0].cpu().numpy(),
            size=np.array(cameras.size),
        )


def _images(folder: Path, what: str) -> dict[tuple[str, str], Path]:
    return _files(folder, what, SUFFIXES)


def _files(folder: Path, what: str, suffixes: frozenset[str]) -> dict[tuple[str, str], Path]:
    """Files by scene and stem, one level deep, in natural order."""
    if not folder.is_dir():
        raise ValueError(f"there is no {what} folder {folder}")
    paths = [path for path in folder.iterdir() if path.is_file()]
    for inside in (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        nested = inside / "images" if (inside / "images").is_dir() else inside
        paths += [path for path in nested.iterdir() if path.is_file()]
    found: dict[tuple[str, str], Path] = {}
    for path in sorted(paths, key=lambda path: natural(path.relative_to(folder).as_posix())):
        if path.suffix.lower() not in suffixes or path.name.startswith("."):
            continue
        parts = path.relative_to(folder).parts
        key = (parts[0] if len(parts) > 1 and parts[0] != "images" else "", path.stem)
        if key in found:
            raise ValueError(f"{found[key]} and {path} are the same image of the {what} folder; keep one of them")
        found[key] = path
    if not found:
        raise ValueError(f"the {what} folder {folder} holds no {'depth (.npy)' if what == 'depth' else 'image'}")
    return found


def _key(name: str) -> str:
    return str(int(name)) if re.fullmatch(r"\d{1,9}", name) else name


def _index(files: Mapping[tuple[str, str], Path]) -> dict[tuple[str, str], Path]:
    return {(scene, _key(stem)): path for (scene, stem), path in files.items()}


def _lookup(index: Mapping[tuple[str, str], Path], scene: str, names: Iterable[str]) -> Path | None:
    for name in names:
        for place in (scene, ""):
            if (place, _key(name)) in index:
                return index[place, _key(name)]
    return None


def _partners(
    scene: str,
    stem: str,
    content: Mapping[tuple[str, str], Path],
    style: Mapping[tuple[str, str], Path],
) -> tuple[str, str, Path, Path] | str:
    """Style and frame by name, photograph and style image; or what is missing."""
    name, _, frame = stem.rpartition("_")
    if not name:
        name = frame = stem
    # Under the stylized image's own name first: a triple of equal names leaves nothing to guess.
    photograph = _lookup(content, scene, (stem, frame))
    reference = _lookup(style, scene, (stem, name))
    if photograph is None and reference is None:
        return f"no content {frame}, no style {name}"
    if photograph is None:
        return f"no content {frame}"
    if reference is None:
        return f"no style {name}"
    return name, frame, photograph, reference


def _cell(scene: str, style: str, rows: list[tuple[str, Path, Path, Path, Path | None]], depth: Path | None) -> Cell:
    rows = sorted(rows, key=lambda row: natural(row[0]))
    cameras = None if depth is None else depth / scene / CAMERAS
    return Cell(
        scene=scene,
        style=style,
        frames=tuple(row[0] for row in rows),
        content=tuple(row[1] for row in rows),
        stylized=tuple(row[3] for row in rows),
        reference=rows[0][2],
        depth=tuple(row[4] for row in rows if row[4] is not None),
        cameras=cameras if cameras is not None and cameras.is_file() else None,
    )


def _natural_pair(key: tuple[str, str]) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    return natural(key[0]), natural(key[1])


def _named(path: Path, root: Path) -> str:
    return f"{root.name}/{path.relative_to(root).as_posix()}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _size(image: Tensor) -> str:
    return f"{image.shape[-1]}x{image.shape[-2]}"
