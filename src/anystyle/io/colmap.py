"""COLMAP's sparse models, text and binary: cameras, images and points.

The layout is the one that COLMAP documents under "Output Format": ``cameras``, ``images`` and ``points3D``, each
``.txt`` or ``.bin`` (little-endian, no padding).
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import read_bytes

NUM_PARAMETERS: Mapping[str, int] = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
}  # fmt: skip
"""How many parameters each camera model has, in the order of the models' numbers in binary files."""
MODELS = tuple(NUM_PARAMETERS)
ONE_FOCAL = frozenset({"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"})
"""Models whose parameters begin with ``f, cx, cy``; those of the others begin with ``fx, fy, cx, cy``."""
MAX_BYTES = 1 << 30
"""The largest file of a model that is read."""


@dataclass(frozen=True)
class Camera:
    """A camera: one of :data:`MODELS`, height and width, and the parameters as the model orders them, in pixels."""

    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """The 3x3 matrix, without distortion."""
        if self.model in ONE_FOCAL:
            (fx, cx, cy), fy = self.parameters[:3], self.parameters[0]
        else:
            fx, fy, cx, cy = self.parameters[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> tuple[float, ...]:
        """The parameters that the matrix leaves out."""
        return self.parameters[3 if self.model in ONE_FOCAL else 4 :]


@dataclass(frozen=True)
class Photograph:
    """A posed image: file, number of its camera, unit quaternion wxyz and translation of camera from world."""

    name: str
    camera: int
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]


@dataclass(frozen=True)
class Model:
    """A sparse model: cameras and images by number, ``N x 3`` positions in the world and their sRGB bytes."""

    cameras: Mapping[int, Camera]
    photographs: Mapping[int, Photograph]
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    colors: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))


def pinhole_model(
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    intrinsics: NDArray[np.float64],
    camera_from_world: NDArray[np.float64],
    points: NDArray[np.float64],
    colors: NDArray[np.uint8],
) -> Model:
    """A model of images, each with a pinhole camera of its own; sizes are height and width in pixels."""
    quaternions = Rotation.from_matrix(camera_from_world[:, :3, :3]).as_quat(canonical=True)
    cameras, photographs = {}, {}
    for number, (name, size) in enumerate(zip(names, sizes, strict=True), start=1):
        (fx, _, cx), (_, fy, cy), _ = intrinsics[number - 1].tolist()
        x, y, z, w = quaternions[number - 1].tolist()
        tx, ty, tz = camera_from_world[number - 1, :3, 3].tolist()
        cameras[number] = Camera("PINHOLE", size, (fx, fy, cx, cy))
        photographs[number] = Photograph(name, number, (w, x, y, z), (tx, ty, tz))
    return Model(cameras, photographs, points, colors)


def _suffix(folder: Path) -> str | None:
    names = ("images", "cameras")
    return next((suffix for suffix in ("bin", "txt") if all((folder / f"{n}.{suffix}").is_file() for n in names)), None)


def find(folder: Path) -> Path | None:
    """The folder of a capture's sparse model: the given one, or one below it where COLMAP and its users put it."""
    candidates = (folder / inside for inside in ("", "sparse/0", "sparse", "colmap/sparse/0", "0"))
    return next((candidate for candidate in candidates if _suffix(candidate)), None)


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
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise UserError(f"{path} is damaged or no file of COLMAP's ({str(error).splitlines()[0]})") from None
    for photograph in photographs.values():
        if photograph.camera not in cameras:
            raise UserError(f"{path} has {photograph.name} with camera {photograph.camera}, which is not there")
    return Model(cameras, photographs)


def _camera(model: str, width: int, height: int, parameters: Sequence[float]) -> Camera:
    camera = Camera(model, (height, width), tuple(parameters))
    focal = camera.intrinsics[[0, 1], [0, 1]]
    sizes = 0 < width < 2**20 and 0 < height < 2**20 and len(parameters) == NUM_PARAMETERS[model]
    if not (sizes and np.isfinite(parameters).all() and (focal > 0).all()):
        raise UserError(f"a camera {model} of {width}x{height} pixels with the parameters {camera.parameters[:12]}")
    return camera


def _photograph(pose: Sequence[float], camera: int, name: str) -> Photograph:
    norm = float(np.linalg.norm(pose[:4]))
    if len(pose) != 7 or not np.isfinite(pose).all() or abs(norm - 1) > 1e-2:
        raise UserError(f"the pose of {name[:80]} is no rotation and translation")
    w, x, y, z = (value / norm for value in pose[:4])
    return Photograph(name, camera, (w, x, y, z), (pose[4], pose[5], pose[6]))


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
        name, self.offset = self.data[self.offset : end].decode("utf-8"), end + 1
        return name


def _binary_cameras(data: bytes) -> Iterator[tuple[Any, ...]]:
    records = _Records(data)
    for _ in range(records.count(48)):
        number, index, width, height = records.take("iiQQ")
        if not 0 <= index < len(MODELS):
            raise UserError(f"camera model {index} is unknown")
        yield number, MODELS[index], width, height, records.take(f"{NUM_PARAMETERS[MODELS[index]]}d")


def _binary_images(data: bytes) -> Iterator[tuple[Any, ...]]:
    records = _Records(data)
    for _ in range(records.count(73)):
        number, *pose, camera = records.take("i7di")
        yield number, pose, camera, records.text()
        num_points = records.count(24)  # that are seen in the image
        records.offset += 24 * num_points


def _text_cameras(data: bytes) -> Iterator[tuple[Any, ...]]:
    for line in data.decode("utf-8").splitlines():
        if line.strip() and not line.startswith("#"):
            number, model, width, height, *parameters = line.split()
            yield int(number), model, int(width), int(height), tuple(map(float, parameters))


def _text_images(data: bytes) -> Iterator[tuple[Any, ...]]:
    lines = (line.strip() for line in data.decode("utf-8").splitlines() if not line.startswith("#"))
    for line in lines:
        if line:  # blank lines may lie between records; the line of points, which may be blank too, is skipped below
            number, *pose, camera, name = line.split(maxsplit=9)
            yield int(number), list(map(float, pose)), int(camera), name
            next(lines, "")


def write(model: Model, folder: Path, *, binary: bool = True) -> None:
    """Write a model's three files into a folder; points carry no tracks, and names no line breaks (text: no blanks)."""
    for photograph in model.photographs.values():
        if any(letter in photograph.name for letter in "\n\r\0") or (not binary and " " in photograph.name):
            raise UserError(f"the image name {photograph.name!r} cannot be written; rename it, or write binary files")
    folder.mkdir(parents=True, exist_ok=True)
    suffix, contents = ("bin", _as_bytes(model)) if binary else ("txt", _as_text(model))
    for name, content in zip(("cameras", "images", "points3D"), contents, strict=True):
        with atomic_path(folder / f"{name}.{suffix}") as temporary:
            temporary.write_bytes(content)


def _as_bytes(model: Model) -> Iterator[bytes]:
    cameras = [struct.pack("<Q", len(model.cameras))]
    for number, camera in model.cameras.items():
        fields = (number, MODELS.index(camera.model), camera.size[1], camera.size[0], *camera.parameters)
        cameras.append(struct.pack(f"<iiQQ{len(camera.parameters)}d", *fields))
    images = [struct.pack("<Q", len(model.photographs))]
    for number, photograph in model.photographs.items():
        images.append(struct.pack("<i7di", number, *photograph.rotation, *photograph.translation, photograph.camera))
        images.append(photograph.name.encode() + b"\0" + struct.pack("<Q", 0))
    record = [("number", "<u8"), ("position", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")]
    points = np.zeros(len(model.points), dtype=record)
    points["number"] = np.arange(1, len(points) + 1)
    points["position"], points["color"] = model.points, model.colors
    yield from (b"".join(cameras), b"".join(images), struct.pack("<Q", len(points)) + points.tobytes())


def _as_text(model: Model) -> Iterator[bytes]:
    def row(*values: object) -> str:
        return " ".join(map(str, values)) + "\n"

    cameras = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    for number, camera in model.cameras.items():
        cameras += row(number, camera.model, camera.size[1], camera.size[0], *camera.parameters)
    images = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    for number, shot in model.photographs.items():
        images += row(number, *shot.rotation, *shot.translation, shot.camera, shot.name) + "\n"
    points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"]
    for number, (position, color) in enumerate(zip(model.points.tolist(), model.colors.tolist(), strict=True), start=1):
        points.append(row(number, *position, *color, 0.0))
    yield from (cameras.encode(), images.encode(), "".join(points).encode())
