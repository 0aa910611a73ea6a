"""COLMAP's models, which Metashape and RealityScan export, too."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.names import matched
from anystyle.errors import UserError
from anystyle.io.colmap import Camera, Model
from anystyle_captures.camera_files import colmap_files, samples
from anystyle_captures.camera_files.conversion import by_name, camera, finished
from anystyle_captures.camera_files.lens import Lens

_log = logging.getLogger(__name__)
_POLYNOMIAL = frozenset(
    {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "SIMPLE_FISHEYE", "FISHEYE"}
) | {"SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"}
"""Models whose terms are those of a :class:`Lens`."""


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
        return colmap_files.find(path)

    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        models = {folder: colmap_files.read(folder) for folder in colmap_files.models(path)}
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
        raise UserError(f"{path} has EQUIRECTANGULAR cameras, whose images are panoramas; cut them into views first")
    (fx, fy, cx, cy), terms = colmap_files.split(stored)
    if stored.model not in _POLYNOMIAL or (stored.model == "FULL_OPENCV" and any(terms[5:])):
        return Lens(stored.size, (fx, fy), (cx, cy), colmap=stored)
    tangential = (0.0, 0.0)
    if stored.model in ("OPENCV", "FULL_OPENCV"):
        tangential, terms = (terms[2], terms[3]), (*terms[:2], *terms[4:5])
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    return Lens(stored.size, (fx, fy), (cx, cy), (k1, k2, k3, k4), tangential, fisheye="FISHEYE" in stored.model)
