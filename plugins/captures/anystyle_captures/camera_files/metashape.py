"""Agisoft Metashape's ``cameras.xml`` (File > Export > Export Cameras, Agisoft XML)."""

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.errors import UserError
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import by_name, camera, files_of, finished, rigid
from anystyle_captures.camera_files.lens import Lens
from anystyle_captures.camera_files.xml import number, numbers, read_xml, starts_with

_log = logging.getLogger(__name__)
_WHAT = "file of Metashape cameras"
_FISHEYE = ("fisheye", "equidistant_fisheye")
_UNDISTORT = "export undistorted photographs with a COLMAP model from Metashape instead"


class Metashape(CameraReader):
    """Cameras that Metashape exported as XML: poses, calibrations of sensors, the transforms of chunk and components.

    Cameras look along +z with y down. Its frame cameras have four radial terms, P1 and P2 in the other order than
    OpenCV's, and an affinity b1, b2; the photographs are undistorted. Fisheye cameras are read, others refused.
    """

    expects = "cameras.xml of Metashape"
    rank = 40

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        images = samples.write_photographs(folder / "images")
        samples.write_metashape(folder / "cameras.xml", images, samples.poses(), samples.pinhole())
        return {}

    def find(self, path: Path) -> Path | None:
        files = files_of(path, ".xml")
        return next((file for file in files if starts_with(file, "<document") and starts_with(file, "<chunk")), None)

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        root = read_xml(path, _WHAT)
        try:
            cameras = _cameras(root)
        except (ValueError, TypeError) as error:
            raise UserError(f"{path} is not a {_WHAT} that can be read: {error}") from None
        return finished(by_name(cameras, path), images)


def _cameras(root: Element) -> list[tuple[str, StoredCamera]]:
    chunks = [chunk for chunk in root.iter("chunk") if any(_aligned(chunk))]
    if len(chunks) != 1:
        raise UserError(f"it has {len(chunks)} chunks with aligned cameras; export one")
    chunk = chunks[0]
    aligned = _aligned(chunk)
    worlds = {part.get("id"): _similarity(part) for part in chunk.iter("component")}
    shared = _similarity(chunk)
    # Components without a transform of their own lie in frames that have nothing in common.
    loose = Counter(each.get("component_id") for each in aligned if worlds.get(each.get("component_id")) is None)
    if len(loose) > 1:
        [(largest, _)] = loose.most_common(1)
        _log.warning("of %d components, which Metashape did not align with each other, the largest is read", len(loose))
        aligned = [each for each in aligned if each.get("component_id") == largest]
    lenses: dict[str | None, Lens] = {}
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    # A label is the name of a file without its folder, which groups of cameras may stand for.
    groups = {each: f"{group.get('label', '')}/" for group in chunk.iter("group") for each in group.iter("camera")}
    labels = Counter(each.get("label") for each in aligned)
    cameras = []
    for each in aligned:
        sensor, label = each.get("sensor_id"), each.get("label") or ""
        label = groups.get(each, "") + label if labels[label] > 1 else label
        if sensor not in sensors:
            raise UserError(f"the sensor of {label} is not there")
        lenses[sensor] = lenses.get(sensor) or _lens(sensors[sensor])
        chunk_from_camera = np.array(numbers(each.findtext("transform"), 16, f"the transform of {label}"))
        own, pose = worlds.get(each.get("component_id")), chunk_from_camera.reshape(4, 4)
        world_from_chunk = shared if own is None else own
        if world_from_chunk is not None:
            pose = world_from_chunk @ pose
            pose[:3, :3] /= np.cbrt(np.linalg.det(world_from_chunk[:3, :3]))
        cameras.append((label, camera(rigid(pose), lenses[sensor])))
    return cameras


def _aligned(chunk: Element) -> list[Element]:
    """The cameras with a pose, in groups or not."""
    return [each for each in chunk.iter("camera") if each.find("transform") is not None]


def _similarity(element: Element) -> np.ndarray | None:
    """The 4x4 transform of a chunk or component into the world: rotation, translation and scale."""
    transform = element.find("transform")
    if transform is None or transform.find("rotation") is None:
        return None
    scale = number(transform, "scale", 1.0)
    if not 0 < scale < float("inf"):
        raise UserError(f"a transform has the scale {scale:g}")
    matrix = np.eye(4)
    rotation = numbers(transform.findtext("rotation"), 9, "the rotation of a transform")
    matrix[:3, :3] = scale * rigid(np.array(rotation).reshape(3, 3) @ np.eye(3, 4))[:3, :3]
    if transform.find("translation") is not None:
        matrix[:3, 3] = numbers(transform.findtext("translation"), 3, "the translation of a transform")
    return matrix


def _lens(sensor: Element) -> Lens:
    label, kind = sensor.get("label", ""), sensor.get("type", "frame")
    if kind != "frame" and kind not in _FISHEYE:
        raise UserError(f"the sensor {label!r} is of type {kind}, not frame or fisheye; {_UNDISTORT}")
    calibrations = {each.get("class"): each for each in sensor.findall("calibration")}
    calibration = calibrations.get("adjusted", calibrations.get("initial"))
    if calibration is None or calibration.find("f") is None:
        raise UserError(f"the sensor {label!r} has no calibration with f, as Metashape writes one after alignment")
    if number(calibration, "p3") or number(calibration, "p4"):
        raise UserError(f"the sensor {label!r} has tangential terms p3 and p4; {_UNDISTORT}")
    size = calibration.find("resolution")
    size = sensor.find("resolution") if size is None else size
    if size is None:
        raise UserError(f"the sensor {label!r} has no resolution")
    width, height = int(size.get("width", "0")), int(size.get("height", "0"))
    f, cx, cy, b1, b2, p1, p2 = (number(calibration, name) for name in ("f", "cx", "cy", "b1", "b2", "p1", "p2"))
    k1, k2, k3, k4 = (number(calibration, name) for name in ("k1", "k2", "k3", "k4"))
    focal, center = (f + b1, f), (0.5 * width + cx, 0.5 * height + cy)
    return Lens((height, width), focal, center, (k1, k2, k3, k4), (p2, p1), skew=b2, fisheye=kind in _FISHEYE)
