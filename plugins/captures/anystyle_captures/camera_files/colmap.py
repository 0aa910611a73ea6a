"""COLMAP's models, which Metashape and RealityScan export, too."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from scipy.spatial.transform import Rotation

from anystyle.data.camera_reader import CameraReader, StoredCamera
from anystyle.errors import UserError
from anystyle.io.colmap import Camera
from anystyle_captures.camera_files import colmap_files, samples
from anystyle_captures.camera_files.lens import Lens
from anystyle_captures.camera_files.poses import camera, finished


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
        model = colmap_files.read(path)
        lenses = {number: _lens(stored, path) for number, stored in model.cameras.items()}
        cameras = {}
        for photograph in model.photographs.values():
            w, x, y, z = photograph.rotation
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix().T
            pose[:3, 3] = -pose[:3, :3] @ np.array(photograph.translation)
            cameras[PurePosixPath(photograph.name).name] = camera(pose, lenses[photograph.camera])
        return finished(cameras, images)


def _lens(stored: Camera, path: Path) -> Lens:
    (fx, fy, cx, cy), terms = colmap_files.split(stored)
    if stored.model in ("FOV", "THIN_PRISM_FISHEYE") or (stored.model == "FULL_OPENCV" and any(terms[5:])):
        raise UserError(f"{path} has {stored.model} cameras; undistort the images (colmap image_undistorter) first")
    tangential = (0.0, 0.0)
    if stored.model in ("OPENCV", "FULL_OPENCV"):
        tangential, terms = (terms[2], terms[3]), (*terms[:2], *terms[4:5])
    k1, k2, k3, k4 = (*terms, 0.0, 0.0, 0.0, 0.0)[:4]
    return Lens(stored.size, (fx, fy), (cx, cy), (k1, k2, k3, k4), tangential, fisheye="FISHEYE" in stored.model)
