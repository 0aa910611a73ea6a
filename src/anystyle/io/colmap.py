"""COLMAP's sparse models, and writing them in the text and binary layouts of its documentation's "Output Format"."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.errors import UserError
from anystyle.io.atomic import write_bytes

NUM_PARAMETERS: Mapping[str, int] = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4, "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4, "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}  # fmt: skip
"""How many parameters each camera model has, in the order of the models' numbers in binary files."""
MODELS = tuple(NUM_PARAMETERS)


@dataclass(frozen=True)
class Camera:
    """A camera: one of :data:`MODELS`, height and width, and the parameters as the model orders them, in pixels."""

    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class PosedImage:
    """A posed image: file, number of its camera, unit quaternion wxyz and translation of camera from world."""

    name: str
    camera: int
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]


@dataclass(frozen=True)
class Model:
    """A sparse model: cameras and images by number, ``N x 3`` positions in the world and their sRGB bytes."""

    cameras: Mapping[int, Camera]
    photographs: Mapping[int, PosedImage]
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
        cameras[number] = Camera("PINHOLE", size, (fx, fy, cx, cy))
        translation = camera_from_world[number - 1, :3, 3].tolist()
        photographs[number] = PosedImage(name, number, (w, x, y, z), tuple(translation))
    return Model(cameras, photographs, points, colors)


def write(model: Model, folder: Path, *, binary: bool = True) -> None:
    """Write a model's three files into a folder; points carry no tracks, and names no line breaks (text: no blanks)."""
    for photograph in model.photographs.values():
        if any(letter in photograph.name for letter in "\n\r\0") or (not binary and " " in photograph.name):
            raise UserError(f"the image name {photograph.name!r} cannot be written; rename it, or write binary files")
    folder.mkdir(parents=True, exist_ok=True)
    suffix, contents = ("bin", _as_bytes(model)) if binary else ("txt", _as_text(model))
    for name, content in zip(("cameras", "images", "points3D"), contents, strict=True):
        write_bytes(folder / f"{name}.{suffix}", content)


def _as_bytes(model: Model) -> Iterator[bytes]:
    cameras = [struct.pack("<Q", len(model.cameras))]
    for number, camera in model.cameras.items():
        fields = (number, MODELS.index(camera.model), camera.size[1], camera.size[0], *camera.parameters)
        cameras.append(struct.pack(f"<iiQQ{len(camera.parameters)}d", *fields))
    images = [struct.pack("<Q", len(model.photographs))]
    for number, photograph in model.photographs.items():
        images.append(struct.pack("<i7di", number, *photograph.rotation, *photograph.translation, photograph.camera))
        images.append(photograph.name.encode("utf-8", "surrogateescape") + b"\0" + struct.pack("<Q", 0))
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
    yield from (cameras.encode(), images.encode("utf-8", "surrogateescape"), "".join(points).encode())
