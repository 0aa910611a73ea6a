"""Reading COLMAP's sparse models, which may be damaged.

The layout is the one that COLMAP documents under "Output Format"; see :mod:`anystyle.io.colmap`.
"""

import codecs
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from anystyle.errors import UserError
from anystyle.io.colmap import MODELS, NUM_PARAMETERS, Camera, Model, PosedImage
from anystyle.io.documents import read_bytes
from anystyle_captures.camera_files.lens import MAX_SIDE

ONE_FOCAL = frozenset(
    {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_DIVISION"}
) | {"SIMPLE_FISHEYE"}
"""Models whose parameters begin with ``f, cx, cy``; those of the others begin with ``fx, fy, cx, cy``."""
UNDISTORT = (
    "undistort the photographs first: colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT"
)
MAX_BYTES = 1 << 30
"""The largest file of a model that is read."""


def split(camera: Camera) -> tuple[tuple[float, float, float, float], tuple[float, ...]]:
    """The focal lengths and the principal point, fx, fy, cx and cy, and the terms of distortion."""
    if camera.model in ONE_FOCAL:
        f, cx, cy, *terms = camera.parameters
        return (f, f, cx, cy), tuple(terms)
    fx, fy, cx, cy, *terms = camera.parameters
    return (fx, fy, cx, cy), tuple(terms)


def _suffix(folder: Path) -> str | None:
    names = ("images", "cameras")
    return next((suffix for suffix in ("bin", "txt") if all((folder / f"{n}.{suffix}").is_file() for n in names)), None)


def find(folder: Path) -> Path | None:
    """The folder of a capture's sparse model or models: the given one, or one below it where they are put."""
    candidates = (folder / inside for inside in ("", "sparse", "colmap/sparse"))
    found = next((candidate for candidate in candidates if models(candidate)), None)
    return models(found)[0] if found is not None and len(models(found)) == 1 else found


def models(folder: Path) -> list[Path]:
    """The folders of models that do not connect, which COLMAP numbers, and a folder itself where that is one."""
    numbered = sorted(
        (path for path in folder.glob("[0-9]*") if path.name.isdecimal()), key=lambda path: int(path.name)
    )
    return [path for path in (*numbered, folder) if _suffix(path)]


def read(folder: Path) -> Model:
    """Read the cameras and images of a model, which may be damaged; binary files are preferred, as COLMAP does."""
    suffix = _suffix(folder)
    if suffix is None:
        raise UserError(f"there is no COLMAP model in {folder}")
    readers = (_binary_cameras, _binary_images) if suffix == "bin" else (_text_cameras, _text_images)
    path = folder / f"cameras.{suffix}"
    try:
        cameras = {number: _camera(*fields) for number, *fields in readers[0](read_bytes(path, most=MAX_BYTES))}
        path = folder / f"images.{suffix}"
        photographs = {number: _photograph(*fields) for number, *fields in readers[1](read_bytes(path, most=MAX_BYTES))}
    except _UnknownModel as error:
        raise UserError(f"{path} has cameras of the model {error}, which is not known; {UNDISTORT}") from None
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise UserError(f"{path} is damaged or no file of COLMAP's ({str(error).splitlines()[0]})") from None
    for photograph in photographs.values():
        if photograph.camera not in cameras:
            raise UserError(f"{path} has {photograph.name} with camera {photograph.camera}, which is not there")
    return Model(cameras, photographs)


class _UnknownModel(LookupError):
    """A camera model of a later version of COLMAP."""


def _camera(model: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    if model not in NUM_PARAMETERS:
        raise _UnknownModel(model[:40])
    camera = Camera(model, (height, width), tuple(parameters))
    sizes = 0 < width < MAX_SIDE and 0 < height < MAX_SIDE and len(parameters) == NUM_PARAMETERS[model]
    lens = model == "EQUIRECTANGULAR" or (sizes and min(split(camera)[0][:2]) > 0)
    if not (sizes and lens and np.isfinite(parameters).all()):
        raise UserError(f"a camera {model} of {width}x{height} pixels with the parameters {camera.parameters[:12]}")
    return camera


def _photograph(pose: Sequence[float], camera: int, name: str) -> PosedImage:
    norm = float(np.linalg.norm(pose[:4]))
    if len(pose) != 7 or not np.isfinite(pose).all() or abs(norm - 1) > 1e-2:
        raise UserError(f"the pose of {name[:80]} is no rotation and translation")
    w, x, y, z = (value / norm for value in pose[:4])
    return PosedImage(name, camera, (w, x, y, z), (pose[4], pose[5], pose[6]))


def _text(data: bytes) -> str:
    """Names may be in another encoding than UTF-8, which is found out when they are matched with files."""
    return data.removeprefix(codecs.BOM_UTF8).decode("utf-8", "surrogateescape")


class _Records:
    """Little-endian records, never more than there are."""

    def __init__(self, data: bytes) -> None:
        self.data, self.offset = data, 0

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from(f"<{layout}", self.data, self.offset)
        self.offset += struct.calcsize(f"<{layout}")
        return values

    def count(self, smallest: int) -> int:
        """A number of records of at least ``smallest`` bytes each."""
        (number,) = self.take("Q")
        if number * smallest > len(self.data) - self.offset:
            raise UserError(f"{number} records are announced, more than the file holds")
        return number

    def text(self) -> str:
        end = self.data.index(b"\0", self.offset, self.offset + 4096)
        name, self.offset = _text(self.data[self.offset : end]), end + 1
        return name


def _binary_cameras(data: bytes) -> Iterator[tuple[Any, ...]]:
    records = _Records(data)
    for _ in range(records.count(40)):
        number, index, width, height = records.take("iiQQ")
        if not 0 <= index < len(MODELS):
            raise _UnknownModel(f"number {index}")
        yield number, MODELS[index], width, height, records.take(f"{NUM_PARAMETERS[MODELS[index]]}d")


def _binary_images(data: bytes) -> Iterator[tuple[Any, ...]]:
    records = _Records(data)
    for _ in range(records.count(73)):
        number, *pose, camera = records.take("i7di")
        yield number, pose, camera, records.text()
        num_points = records.count(24)  # that are seen in the image
        records.offset += 24 * num_points


def _text_cameras(data: bytes) -> Iterator[tuple[Any, ...]]:
    for line in _text(data).splitlines():
        if line.strip() and not line.startswith("#"):
            number, model, width, height, *parameters = line.split()
            yield int(number), model, int(width), int(height), tuple(map(float, parameters))


def _text_images(data: bytes) -> Iterator[tuple[Any, ...]]:
    lines = (line.strip() for line in _text(data).splitlines() if not line.startswith("#"))
    for line in lines:
        if line:  # blank lines may lie between records; the line of points, which may be blank too, is skipped below
            number, *pose, camera, name = line.split(maxsplit=9)
            yield int(number), list(map(float, pose)), int(camera), name
            next(lines, "")
