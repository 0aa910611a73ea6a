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

from anystyle.io.atomic import atomic_path

MODELS: Mapping[int, tuple[str, int]] = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}
"""For each number of a camera model, its name and how many parameters it has."""
ONE_FOCAL = frozenset({"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"})
"""Models whose parameters begin with ``f, cx, cy``; those of the others begin with ``fx, fy, cx, cy``."""
_PARAMETERS = dict(MODELS.values())
_NUMBERS = {name: number for number, (name, _) in MODELS.items()}
_LONGEST_NAME = 4096


@dataclass(frozen=True)
class Camera:
    """A camera's size and intrinsics.

    Args:
        model: Of :data:`MODELS`.
        size: Height and width in pixels.
        parameters: As the model orders them, in pixels.
    """

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
        """What the matrix leaves out."""
        return self.parameters[3 if self.model in ONE_FOCAL else 4 :]


@dataclass(frozen=True)
class Photograph:
    """A posed image.

    Args:
        name: Its file, below the folder of images.
        camera: Number of its camera.
        rotation: Camera from world, unit quaternion wxyz.
        translation: Camera from world.
    """

    name: str
    camera: int
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]


@dataclass(frozen=True)
class Model:
    """A sparse model.

    Args:
        cameras: By number.
        photographs: By number.
        points: ``N x 3`` positions in the world.
        colors: ``N x 3`` sRGB bytes.
    """

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
    """A model of ``V`` images, each with a pinhole camera of its own.

    Args:
        names: Files of the images.
        sizes: Height and width of each in pixels.
        intrinsics: ``V x 3 x 3``, in pixels.
        camera_from_world: ``V x 4 x 4`` rigid motions in OpenCV axes.
        points: ``N x 3`` positions.
        colors: ``N x 3`` sRGB bytes.
    """
    quaternions = Rotation.from_matrix(camera_from_world[:, :3, :3]).as_quat(canonical=True)
    cameras, photographs = {}, {}
    for number, (name, size) in enumerate(zip(names, sizes, strict=True), start=1):
        (fx, _, cx), (_, fy, cy), _ = intrinsics[number - 1].tolist()
        x, y, z, w = quaternions[number - 1].tolist()
        tx, ty, tz = camera_from_world[number - 1, :3, 3].tolist()
        cameras[number] = Camera("PINHOLE", size, (fx, fy, cx, cy))
        photographs[number] = Photograph(name, number, (w, x, y, z), (tx, ty, tz))
    return Model(cameras, photographs, points, colors)


_SUFFIXES = ("bin", "txt")


def find(folder: Path) -> Path | None:
    """The folder of a capture's sparse model: the given one, or one below it where COLMAP and its users put it."""
    candidates = (folder / inside for inside in ("", "sparse/0", "sparse", "colmap/sparse/0", "0"))
    return next((candidate for candidate in candidates if _stored_as(candidate) is not None), None)


def _stored_as(folder: Path) -> str | None:
    """The suffix of a model's files; ``None`` where there is no model."""
    names = ("images", "cameras")
    return next((kind for kind in _SUFFIXES if all((folder / f"{name}.{kind}").is_file() for name in names)), None)


def read(folder: Path) -> Model:
    """Read the cameras and images of a model; binary files are preferred, as COLMAP does.

    Raises:
        ValueError: There is no model, a file is damaged or truncated, or a camera model is unknown.
    """
    kind = _stored_as(folder)
    if kind is None:
        raise ValueError(f"there is no COLMAP model in {folder}")
    cameras_file, images_file = folder / f"cameras.{kind}", folder / f"images.{kind}"
    readers = (_binary_cameras, _binary_photographs) if kind == "bin" else (_text_cameras, _text_photographs)
    cameras, path = {}, cameras_file
    try:
        cameras = readers[0](cameras_file)
        path = images_file
        photographs = readers[1](images_file)
    except (struct.error, ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is damaged or no file of COLMAP's ({str(error).splitlines()[0]})") from None
    for photograph in photographs.values():
        if photograph.camera not in cameras:
            raise ValueError(f"{images_file} has {photograph.name} with camera {photograph.camera}, which is not there")
    return Model(cameras, photographs)


def write(model: Model, folder: Path, *, binary: bool = True) -> None:
    """Write a model's three files into a folder; points carry no tracks.

    Raises:
        ValueError: A name of an image has a line break in it, or a blank where text is written.
    """
    for photograph in model.photographs.values():
        if any(letter in photograph.name for letter in "\n\r\0") or (not binary and " " in photograph.name):
            raise ValueError(f"the image name {photograph.name!r} cannot be written; rename it, or write binary files")
    folder.mkdir(parents=True, exist_ok=True)
    kind, writers = ("bin", _BINARY) if binary else ("txt", _TEXT)
    for name, writer in zip(("cameras", "images", "points3D"), writers, strict=True):
        with atomic_path(folder / f"{name}.{kind}") as temporary:
            temporary.write_bytes(b"".join(writer(model)))


class _Bytes:
    """Reads little-endian records, and never more than there are."""

    def __init__(self, path: Path) -> None:
        self.data, self.offset = path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from(f"<{layout}", self.data, self.offset)
        self.offset += struct.calcsize(f"<{layout}")
        return values

    def count(self, smallest: int) -> int:
        """A number of records that fit into what is left."""
        (number,) = self.take("Q")
        if number * smallest > len(self.data) - self.offset:
            raise ValueError(f"{number} records are announced, more than the file holds")
        return int(number)

    def text(self) -> str:
        end = self.data.index(b"\0", self.offset, self.offset + _LONGEST_NAME)
        name, self.offset = self.data[self.offset : end].decode("utf-8"), end + 1
        return name

    def skip(self, count: int) -> None:
        if count > len(self.data) - self.offset:
            raise ValueError("it ends in the middle of a record")
        self.offset += count


def _binary_cameras(path: Path) -> dict[int, Camera]:
    file = _Bytes(path)
    cameras = {}
    for _ in range(file.count(48)):
        number, model, width, height = (int(value) for value in file.take("iiQQ"))
        name, count = MODELS[model]
        cameras[number] = _camera(name, height, width, file.take(f"{count}d"))
    return cameras


def _binary_photographs(path: Path) -> dict[int, Photograph]:
    file = _Bytes(path)
    photographs = {}
    for _ in range(file.count(73)):
        number, *pose, camera = file.take("i7di")
        photographs[int(number)] = _photograph(file.text(), int(camera), pose)
        file.skip(24 * file.count(24))
    return photographs


def _lines(path: Path) -> Iterator[str]:
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            yield line.strip()


def _text_cameras(path: Path) -> dict[int, Camera]:
    cameras = {}
    for line in filter(None, _lines(path)):
        number, model, width, height, *parameters = line.split()
        if model not in _PARAMETERS or len(parameters) != _PARAMETERS[model]:
            raise ValueError(f"a camera {model} with {len(parameters)} parameters")
        cameras[int(number)] = _camera(model, int(height), int(width), tuple(map(float, parameters)))
    return cameras


def _text_photographs(path: Path) -> dict[int, Photograph]:
    lines = _lines(path)
    photographs = {}
    for line in lines:
        if not line:
            continue  # blank lines between records; the line of points may be blank too, and is taken below
        number, *pose, camera, name = line.split(maxsplit=9)
        photographs[int(number)] = _photograph(name, int(camera), list(map(float, pose)))
        next(lines, "")
    return photographs


def _camera(model: str, height: int, width: int, parameters: tuple[float, ...]) -> Camera:
    camera = Camera(model, (height, width), parameters)
    focal = camera.intrinsics[[0, 1], [0, 1]]
    if not (0 < width < 2**20 and 0 < height < 2**20 and np.isfinite(parameters).all() and (focal > 0).all()):
        raise ValueError(f"a camera of {width}x{height} pixels with the parameters {parameters[:4]}")
    return camera


def _photograph(name: str, camera: int, pose: list[float]) -> Photograph:
    values = np.array(pose)
    norm = float(np.linalg.norm(values[:4]))
    if len(values) != 7 or not np.isfinite(values).all() or abs(norm - 1) > 1e-2:
        raise ValueError(f"the pose of {name[:80]} is no rotation and translation")
    w, x, y, z = (float(value) / norm for value in values[:4])
    return Photograph(name, camera, (w, x, y, z), (float(values[4]), float(values[5]), float(values[6])))


def _cameras_as_bytes(model: Model) -> Iterator[bytes]:
    yield struct.pack("<Q", len(model.cameras))
    for number, camera in model.cameras.items():
        (height, width), parameters = camera.size, camera.parameters
        yield struct.pack(f"<iiQQ{len(parameters)}d", number, _NUMBERS[camera.model], width, height, *parameters)


def _photographs_as_bytes(model: Model) -> Iterator[bytes]:
    yield struct.pack("<Q", len(model.photographs))
    for number, photograph in model.photographs.items():
        yield struct.pack("<i7di", number, *photograph.rotation, *photograph.translation, photograph.camera)
        yield photograph.name.encode() + b"\0" + struct.pack("<Q", 0)


def _points_as_bytes(model: Model) -> Iterator[bytes]:
    yield struct.pack("<Q", len(model.points))
    record = np.zeros(
        len(model.points),
        dtype=[("number", "<u8"), ("position", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")],
    )
    record["number"] = np.arange(1, len(record) + 1)
    record["position"], record["color"] = model.points, model.colors
    yield record.tobytes()


def _cameras_as_text(model: Model) -> Iterator[bytes]:
    yield b"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    for number, camera in model.cameras.items():
        (height, width), parameters = camera.size, " ".join(map(repr, camera.parameters))
        yield f"{number} {camera.model} {width} {height} {parameters}\n".encode()


def _photographs_as_text(model: Model) -> Iterator[bytes]:
    yield b"# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    for number, photograph in model.photographs.items():
        pose = " ".join(map(repr, (*photograph.rotation, *photograph.translation)))
        yield f"{number} {pose} {photograph.camera} {photograph.name}\n\n".encode()


def _points_as_text(model: Model) -> Iterator[bytes]:
    yield b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    for number, (position, color) in enumerate(zip(model.points.tolist(), model.colors.tolist(), strict=True), start=1):
        yield f"{number} {' '.join(map(repr, position))} {' '.join(map(str, color))} 0.0\n".encode()


_BINARY = (_cameras_as_bytes, _photographs_as_bytes, _points_as_bytes)
_TEXT = (_cameras_as_text, _photographs_as_text, _points_as_text)
