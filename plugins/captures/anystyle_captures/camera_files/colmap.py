"""COLMAP's models, which Metashape and RealityScan export, too, and which may be damaged.

The layout is the one that COLMAP documents under "Output Format"; see :mod:`anystyle.io.colmap`.
"""

import codecs
import logging
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.colmap import MODELS, NUM_PARAMETERS, Camera, Model, PosedImage
from anystyle.io.documents import parsing, read_bytes
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import by_name, camera, finished
from anystyle_captures.camera_files.lens import MAX_SIDE, PANORAMAS, Lens

_log = logging.getLogger(__name__)
ONE_FOCAL = frozenset(
    {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_DIVISION"}
) | {"SIMPLE_FISHEYE"}
"""Models whose parameters begin with ``f, cx, cy``; those of the others begin with ``fx, fy, cx, cy``."""
_POLYNOMIAL = ONE_FOCAL - {"SIMPLE_DIVISION"} | {"PINHOLE", "OPENCV", "FULL_OPENCV", "FISHEYE", "OPENCV_FISHEYE"}
"""Models whose terms are those of a :class:`Lens`."""
UNDISTORT = (
    "undistort the photographs first: colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path OUT"
)
UNKNOWN = f"its cameras are of the model {{}}, which is not known; {UNDISTORT}"

MAX_BYTES = 1 << 30
"""The largest file of a model that is read."""


class ColmapModel(CameraReader):
    """A COLMAP model, text or binary, in the folder or where COLMAP and its users put it below."""

    expects = "a COLMAP model"
    rank = 30

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "images")
        samples.write_colmap(folder / "sparse" / "0", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        # The model of undistorted copies, in ``dense``, is found from there.
        places = ("", "sparse", "colmap/sparse", "colmap", "colmap_text", "distorted/sparse")
        found = next((path / place for place in places if _models(path / place)), None)
        return _models(found)[0] if found is not None and len(_models(found)) == 1 else found

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        models = {folder: read(folder) for folder in _models(path)}
        held = {folder: _holds(model, images) for folder, model in models.items()}
        path = max(held, key=lambda folder: held[folder])
        if len(models) > 1:
            others = ", ".join(f"{folder} with {count[0]}" for folder, count in held.items() if folder != path)
            given = f"{held[path][0]} of {len(images)}" if images else f"{held[path][0]}"
            _log.warning("%s is read, with %s photographs; not connected with it and left out: %s", path, given, others)
        cameras = []
        lenses = dict[int, Lens]()
        for photograph in models[path].photographs.values():
            number = photograph.camera
            lenses[number] = lenses.get(number) or _lens(models[path].cameras[number], path)
            w, x, y, z = photograph.rotation
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix().T
            pose[:3, 3] = -pose[:3, :3] @ np.array(photograph.translation)
            cameras.append((photograph.name, camera(pose, lenses[number])))
        return finished(by_name(cameras, path), images)


def _holds(model: Model, images: Sequence[Path]) -> tuple[int, int]:
    """How many of the given photographs a model has, or where none are given, of its own; and of how many."""
    names = [photograph.name for photograph in model.photographs.values()]
    return len(matched(names, images)) if images else len(names), len(names)


def _lens(stored: Camera, path: Path) -> Lens:
    if stored.model == "EQUIRECTANGULAR":
        raise UserError(f"{path} has EQUIRECTANGULAR cameras, whose images are panoramas; {PANORAMAS}")
    (fx, fy, cx, cy), terms = split(stored)
    if stored.model not in _POLYNOMIAL or (stored.model == "FULL_OPENCV" and any(terms[5:])):
        return Lens(stored.size, (fx, fy), (cx, cy), colmap=stored)
    tangential = (0.0, 0.0)
    if stored.model in ("OPENCV", "FULL_OPENCV"):
        tangential, terms = (terms[2], terms[3]), (*terms[:2], *terms[4:5])
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    return Lens(stored.size, (fx, fy), (cx, cy), (k1, k2, k3, k4), tangential, fisheye="FISHEYE" in stored.model)


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


def _models(folder: Path) -> list[Path]:
    """The folders of models that do not connect, which COLMAP numbers, and a folder itself where that is one."""
    numbered = (path for path in folder.glob("[0-9]*") if path.name.isdecimal())
    return [path for path in (*sorted(numbered, key=lambda path: int(path.name)), folder) if _suffix(path)]


def read(folder: Path) -> Model:
    """Read the cameras and images of a model, which may be damaged; binary files are preferred, as COLMAP does."""
    suffix = _suffix(folder) or "txt"
    readers = (_binary_cameras, _binary_images) if suffix == "bin" else (_text_cameras, _text_images)
    tables: list[Any] = []
    for name, rows_of, make in zip(("cameras", "images"), readers, (_camera, _photograph), strict=True):
        path = folder / f"{name}.{suffix}"
        with parsing(path, "file of COLMAP's that is read here"):
            rows = [(number, make(*fields)) for number, *fields in rows_of(read_bytes(path, most=MAX_BYTES))]
            if len(rows) > len(dict(rows)):
                raise ValueError("two records have the same number")
        tables.append(dict(rows))
    cameras, photographs = tables
    for photograph in photographs.values():
        if photograph.camera not in cameras:
            raise UserError(f"{folder} has {photograph.name} with camera {photograph.camera}, which is not there")
    return Model(cameras, photographs)


def _camera(model: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    if model not in NUM_PARAMETERS:
        raise ValueError(UNKNOWN.format(model[:40]))
    stored = Camera(model, (height, width), tuple(parameters))
    sizes = 0 < width < MAX_SIDE and 0 < height < MAX_SIDE and len(parameters) == NUM_PARAMETERS[model]
    lens = model == "EQUIRECTANGULAR" or (sizes and min(split(stored)[0][:2]) > 0)
    if not (sizes and lens and np.isfinite(parameters).all()):
        raise ValueError(f"a camera {model} of {width}x{height} pixels with the parameters {stored.parameters[:12]}")
    return stored


def _photograph(pose: Sequence[float], camera: int, name: str) -> PosedImage:
    norm = float(np.linalg.norm(pose[:4]))
    if len(pose) != 7 or not np.isfinite(pose).all() or abs(norm - 1) > 1e-2:
        raise ValueError(f"the pose of {name[:80]} is not a rotation and translation")
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
            raise ValueError(f"{number} records are announced, more than the file holds")
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
            raise ValueError(UNKNOWN.format(f"number {index}"))
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
    """Records of two lines, of which the second, of points, may be blank; files of other programs may lack it."""
    lines = [line.strip() for line in _text(data).splitlines() if not line.startswith("#")]
    taken = 0
    for index, line in enumerate(lines):
        if index < taken or not line:  # blank lines may lie between records, too
            continue
        number, *pose, camera, name = line.split(maxsplit=9)
        yield int(number), list(map(float, pose)), int(camera), name
        taken = index + (1 if _is_record(lines[index + 1 : index + 2]) else 2)


def _is_record(line: Sequence[str]) -> bool:
    """Whether a line is of an image, which ends in a name after nine numbers; points are numbers in threes."""
    words = line[0].split() if line else []
    try:
        return len([float(word) for word in words]) % 3 > 0
    except ValueError:
        return True
