"""Paired image files as comparisons, and the files beside them: depth, cameras, seconds."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.data.images import image_size, open_alpha, open_image, to_tensor
from anystyle.errors import UserError
from anystyle.evaluation.names import Names
from anystyle.evaluation.pairing import StylizedImages
from anystyle.io.arrays import read_array, read_arrays
from anystyle.io.documents import read_json
from anystyle.io.limits import require
from anystyle.types import Cameras, Comparison, Style

_CAMERAS = (
    "file of cameras: frames (names), world_from_camera [V, 4, 4], intrinsics [V, 3, 3] in pixels, size (height, width)"
)
ASPECT_ERROR = 0.07
"""By which depth may differ from its images' aspect: networks round sides to multiples of their patches."""


class Reader:
    """Reads cells as comparisons; the photographs of a scene are decoded once and stay the same tensor."""

    def __init__(self) -> None:
        self.transparent: dict[str, set[Path]] = {}
        """The images of a kind of which something is transparent, and was put on white."""
        self._content = lru_cache(1)(_read_stack)
        self._reference = lru_cache(256)(read)
        self._depth = lru_cache(1)(_read_depths)

    def __call__(self, cell: StylizedImages) -> Comparison:
        """One cell as a batch of one; a UserError where a file cannot be read or sizes differ."""
        sizes = [image_size(path) for path in (*cell.stylized, *cell.content)]
        require(
            sum(width * height * 3 * (1 + 4 + 4) for width, height in sizes),
            f"{len(sizes)} images of {cell.scene} in {cell.style}, of up to {'x'.join(map(str, max(sizes)))}",
            "give fewer frames a scene, or smaller ones",
        )
        stylized, content = _read_stack(cell.stylized), self._content(cell.content)
        kinds = {"stylized images": cell.stylized, "photographs": cell.content, "style images": (cell.reference,)}
        for kind, paths in kinds.items():
            self.transparent.setdefault(kind, set()).update(path for path in paths if open_alpha(path) is not None)
        if (size := _size(stylized)) != _size(content):
            photograph = f"its photograph {cell.content[0]} {_size(content)}"
            raise UserError(f"{cell.stylized[0]} has {size} pixels and {photograph}; give both in one size")
        seconds = seconds_file(cell.stylized[0].parent, cell.style)
        return Comparison(
            content=content,
            stylized=stylized,
            style=Style(image=self._reference(cell.reference)[None], names=(cell.style,)),
            depth=self._depth(cell.depth, (stylized.shape[-2], stylized.shape[-1])) if any(cell.depth) else None,
            cameras=_read_cameras(cell.cameras, cell, stylized) if cell.cameras else None,
            scenes=(cell.scene,),
            styles=(cell.style,),
            numbers=cell.numbers,
            seconds=torch.tensor([read_seconds(seconds)]) if seconds.is_file() else None,
        )


def read(path: Path) -> Float[Tensor, "3 H W"]:
    """An image at its own size, sRGB in [0, 1]."""
    return to_tensor(open_image(path, longest=1 << 16))


def _read_stack(paths: tuple[Path, ...]) -> Float[Tensor, "1 V 3 H W"]:
    images = [read(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != images[0].shape:
            sizes = f"{path} has {_size(image)} pixels and {paths[0]} {_size(images[0])}"
            raise UserError(f"{sizes}; the images of one scene need one size")
    return torch.stack(images)[None]


def _read_depths(paths: tuple[Path | None, ...], size: tuple[int, int]) -> Float[Tensor, "1 V H W"]:
    """Depth maps at the images' size; 0, as where there is no depth, for a path that is ``None``."""
    what = "array of finite depth of shape [H, W]"
    maps = {path: torch.from_numpy(read_array(path, what=what)).float() for path in paths if path is not None}
    first = next(iter(maps.values()))
    for path, values in maps.items():
        if values.ndim != 2 or values.shape != first.shape or not values.numel():
            raise UserError(f"{path} has shape {list(values.shape)}; the depth of one scene needs one shape [H, W]")
        if bool((values < 0).any()):
            raise UserError(f"{path} has depth from {values.min():g}; expected distances along z, and 0 where unknown")
        if abs(values.shape[1] * size[0] / (values.shape[0] * size[1]) - 1) > ASPECT_ERROR:
            raise UserError(f"{path} has shape {list(values.shape)}, of another aspect than its images, {list(size)}")
    depth = torch.stack([torch.zeros_like(first) if path is None else maps[path] for path in paths])[None]
    # The nearest value: a mean of two surfaces lies on neither.
    return F.interpolate(depth, size, mode="nearest-exact")


def _read_cameras(file: Path, cell: StylizedImages, images: Float[Tensor, "1 V 3 H W"]) -> Cameras:
    arrays = read_arrays(file, ("world_from_camera", "intrinsics", "size"), ("frames",), what=_CAMERAS)
    names, poses, intrinsics = arrays["frames"].tolist(), arrays["world_from_camera"], arrays["intrinsics"]
    shapes = (poses.shape, intrinsics.shape, arrays["size"].shape)
    if shapes != ((len(names), 4, 4), (len(names), 3, 3), (2,)) or not (arrays["size"] >= 1).all():
        raise UserError(f"{file} is not a {_CAMERAS}")
    named, indices = Names(names), list[int]()
    for frame in cell.frames:
        found = named.find(frame)
        if len(found) != 1:
            raise UserError(f"{file} does not hold the cameras of {cell.scene}: {frame!r} is not in it")
        indices.append(names.index(found[0]))
    height, width = (int(side) for side in arrays["size"])
    poses, intrinsics = (torch.from_numpy(values[indices]).float()[None] for values in (poses, intrinsics))
    return Cameras(poses, intrinsics, (height, width)).resized((images.shape[-2], images.shape[-1]))


def write_cameras(path: Path, frames: Sequence[str], cameras: Cameras) -> None:
    """Write the cameras of one scene as :class:`Reader` reads them from beside depth maps."""
    with path.open("wb") as file:
        poses, intrinsics = (tensor[0].cpu().numpy() for tensor in (cameras.world_from_camera, cameras.intrinsics))
        np.savez(file, frames=list(frames), world_from_camera=poses, intrinsics=intrinsics, size=cameras.size)


class _Seconds(msgspec.Struct):
    seconds: Annotated[float, msgspec.Meta(ge=0)]


def seconds_file(folder: Path, style: str) -> Path:
    """The file with the seconds that a scene's images in a style took; written when they are complete."""
    return folder / f".{style}"


def read_seconds(path: Path) -> float:
    """The seconds in a :func:`seconds_file`."""
    stored: _Seconds = read_json(path, _Seconds, what="file of seconds; delete it and evaluate again")
    return stored.seconds


def _size(image: Tensor) -> str:
    return f"{image.shape[-1]}x{image.shape[-2]}"
