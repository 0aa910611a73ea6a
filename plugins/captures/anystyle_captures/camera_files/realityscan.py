"""RealityScan's (formerly RealityCapture's) camera parameters: a table, or a sidecar of every photograph."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.images import image_size
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.documents import read_text
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import OPENCV_FROM_OPENGL, by_name, camera, files_of, finished, rigid
from anystyle_captures.camera_files.lens import Lens
from anystyle_captures.camera_files.xml import numbers, read_xml, starts_with

_COLUMNS = {"z": "alt", "yaw": "heading", "f_35mm": "f", "px_norm": "px", "py_norm": "py"}
"""Names of columns in one version, by those in others."""
_REQUIRED = {"name", "x", "y", "alt", "heading", "pitch", "roll", "f"}
_NUMBERS = _REQUIRED - {"name"} | {"px", "py", "k1", "k2", "k3", "k4", "t1", "t2"}
_XCR = "http://www.capturingreality.com/ns/xcr/1.1#"
_DESCRIPTION = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}Description"
_BROWN = ("perspective", "brown3", "brown3t2", "brown4", "brown4t2")
_UNDISTORT = "align with a Brown model without K+, or export undistorted images with a COLMAP model"


class RealityScan(CameraReader):
    """Cameras of RealityScan and RealityCapture: the table of internal and external parameters, or XMP sidecars.

    Lengths are those of a film 36 mm wide, which is the longer side; principal points are fractions of it. The radial
    terms are Brown's, and t1 and t2 OpenCV's p2 and p1. The photographs, whose sizes neither file has, are undistorted.
    """

    expects = "camera parameters (.csv or .xmp) of RealityScan"
    rank = 50

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "images")
        samples.write_realityscan_table(folder / "cameras.csv", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        if tables := [file for file in files_of(path, ".csv") if _header(file) is not None]:
            return tables[0]
        return path if path.is_dir() and any(starts_with(file, _XCR) for file in files_of(path, ".xmp")) else None

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        read = _from_sidecars if path.is_dir() else _from_table
        return finished(read(path, images), images)


def world_from_camera(heading: float, pitch: float, roll: float) -> np.ndarray:
    """The rotation of angles in degrees, in OpenCV's axes.

    At 0 the camera looks down with its upper side to the north (y); heading turns it clockwise seen from above.
    """
    rotation = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
    return rotation @ OPENCV_FROM_OPENGL[:3, :3]


def _header(path: Path) -> list[str] | None:
    """The columns of a table, if it is one of cameras."""
    with path.open("rb") as file:
        lines = file.read(4096).decode("utf-8-sig", errors="replace").splitlines()
    # A line with the number of cameras may come first.
    for line in lines[:2]:
        names = [name.strip().lstrip("#").lower() for name in line.split(",")]
        names = [_COLUMNS.get(name, name) for name in names]
        if set(names) >= _REQUIRED:
            return names
    return None


def _from_table(path: Path, images: Sequence[Path]) -> dict[str, StoredCamera]:
    names = _header(path)
    assert names is not None
    lines = read_text(path, what="table of cameras").splitlines()
    rows: list[dict[str, str]] = []
    for row in csv.reader(line for line in lines if line.strip() and not line.startswith("#")):
        if len(row) != len(names):
            raise UserError(f"{path} has a row of {len(row)} values for {len(names)} columns: {','.join(row)[:80]}")
        rows.append(dict(zip(names, map(str.strip, row), strict=True)))
    by_row = {name: image for image, name in matched([fields["name"] for fields in rows], images).items()}
    cameras = []
    for fields in (each for each in rows if each["name"] in by_row):
        name, image = fields["name"], by_row[fields["name"]]
        try:
            values = {key: float(text) for key, text in fields.items() if key in _NUMBERS}
            pose = np.eye(4)
            pose[:3, :3] = world_from_camera(values["heading"], values["pitch"], values["roll"])
            pose[:3, 3] = values["x"], values["y"], values["alt"]
            terms = [values.get(term, 0.0) for term in ("k1", "k2", "k3", "k4", "t1", "t2")]
            point = values.get("px", 0.0), values.get("py", 0.0)
            cameras.append((name, camera(rigid(pose), _lens(image, values["f"], point, terms))))
        except ValueError as error:
            raise UserError(f"{path}: the camera of {name} cannot be read ({error})") from None
    return by_name(cameras, path)


def _from_sidecars(folder: Path, images: Sequence[Path]) -> dict[str, StoredCamera]:
    cameras = {}
    sidecars = {path.name: path for path in sorted(folder.glob("*.xmp")) if starts_with(path, _XCR)}
    for image, name in matched(sidecars, images).items():
        path = sidecars[name]
        description = next(read_xml(path, "sidecar of RealityScan").iter(_DESCRIPTION), None)
        texts: dict[str, str] = {}
        if description is not None:
            pairs = [*description.attrib.items(), *((each.tag, each.text or "") for each in description)]
            texts = {name.removeprefix(f"{{{_XCR}}}"): text for name, text in pairs}
        if "Rotation" not in texts or "Position" not in texts:
            continue  # a photograph without a pose
        try:
            cameras[str(image)] = _of_sidecar(texts, image)
        except ValueError as error:
            raise UserError(f"{path}: the camera cannot be read ({error})") from None
    return cameras


def _of_sidecar(texts: Mapping[str, str], image: Path) -> StoredCamera:
    model = texts.get("DistortionModel", "perspective")
    if model not in _BROWN:
        raise UserError(f"its distortion model is {model}, which is not read; {_UNDISTORT}")
    if float(texts.get("Skew", "0")) or float(texts.get("AspectRatio", "1")) != 1:
        raise UserError(f"its pixels are skewed or not square; {_UNDISTORT}")
    if texts.get("Coordinates", "absolute") != "absolute":
        raise UserError("its coordinates are those of a rig; export absolute ones")
    camera_from_world = np.array(numbers(texts["Rotation"], 9, "the rotation")).reshape(3, 3)
    pose = np.eye(4)
    pose[:3, :3] = camera_from_world.T
    pose[:3, 3] = numbers(texts["Position"], 3, "the position")
    plain = model == "perspective"
    terms = [0.0] * 6 if plain else numbers(texts.get("DistortionCoeficients"), 6, "the distortion")
    point = float(texts.get("PrincipalPointU", "0")), float(texts.get("PrincipalPointV", "0"))
    return camera(rigid(pose), _lens(image, float(texts.get("FocalLength35mm", "0")), point, terms))


def _lens(image: Path, focal_35mm: float, point: tuple[float, float], terms: Sequence[float]) -> Lens:
    width, height = image_size(image)
    longer = max(width, height)
    focal, center = focal_35mm / 36 * longer, (0.5 * width + point[0] * longer, 0.5 * height + point[1] * longer)
    k1, k2, k3, k4, t1, t2 = terms
    return Lens((height, width), (focal, focal), center, (k1, k2, k3, k4), (t2, t1))
