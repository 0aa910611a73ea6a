"""Small captures as each program writes them, for the examples that contracts are checked with, and for tests."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from PIL import Image
from scipy.spatial.transform import Rotation

from anystyle.io import colmap
from anystyle.paths import names_below
from anystyle_captures.camera_files.conversion import OPENCV_FROM_OPENGL
from anystyle_captures.camera_files.lens import Lens

Poses = Sequence[Float64[np.ndarray, "4 4"]]


def write_photographs(folder: Path, size: tuple[int, int] = (48, 64), count: int = 3) -> list[Path]:
    """Pictures of this height and width."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"view_{index}.png" for index in range(count)]
    for index, path in enumerate(paths):
        Image.linear_gradient("L").rotate(20 * index).resize((size[1], size[0])).convert("RGB").save(path)
    return paths


def poses(count: int = 3) -> list[Float64[np.ndarray, "4 4"]]:
    """Cameras that look into various directions."""
    matrices = [np.eye(4) for _ in range(count)]
    for index, matrix in enumerate(matrices):
        matrix[:3, :3] = Rotation.from_euler("xyz", [0.3 - 0.2 * index, 0.4 * index, 0.1 * index**2]).as_matrix()
        matrix[:3, 3] = 0.5 * index, 0.1 * index**2, 1.0 - index
    return matrices


def pinhole(size: tuple[int, int] = (48, 64)) -> Lens:
    """A lens without distortion."""
    return Lens(size, (50.0, 50.0), (size[1] / 2 + 0.5, size[0] / 2 - 0.25))


def write_transforms(path: Path, images: Sequence[Path], world_from_camera: Poses, lens: Lens) -> None:
    """Nerfstudio's processed capture: intrinsics of every frame."""
    numbers = {"fl_x": lens.focal[0], "fl_y": lens.focal[1], "cx": lens.center[0], "cy": lens.center[1]}
    numbers |= {"h": lens.size[0], "w": lens.size[1], "p1": lens.tangential[0], "p2": lens.tangential[1]}
    numbers |= {f"k{index}": value for index, value in enumerate(lens.radial, start=1)}
    frames = []
    for name, pose in zip(names_below(images), world_from_camera, strict=True):
        matrix = (pose @ OPENCV_FROM_OPENGL).tolist()
        frames.append({"file_path": f"images/{name}", "transform_matrix": matrix, **numbers})
    names = [frame["file_path"] for frame in frames]
    content = {"camera_model": "OPENCV_FISHEYE" if lens.fisheye else "OPENCV", "frames": frames}
    content |= {"applied_transform": np.eye(4)[[0, 2, 1]].tolist(), "train_filenames": names[1:], "test_filenames": []}
    path.write_text(json.dumps(content))


def write_gaussian_splatting(path: Path, images: Sequence[Path], world_from_camera: Poses, lens: Lens) -> None:
    """Cameras of a run of 3DGS, which have no principal point."""
    (height, width), (fx, fy) = lens.size, lens.focal
    shared = {"width": width, "height": height, "fy": fy, "fx": fx}
    poses = [{"position": pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()} for pose in world_from_camera]
    names = [{"id": index, "img_name": image.stem} for index, image in enumerate(images)]
    path.write_text(json.dumps([{**name, **shared, **pose} for name, pose in zip(names, poses, strict=True)]))


def write_llff(path: Path, world_from_camera: Poses, lens: Lens) -> None:
    """One row per photograph."""
    rows = []
    for pose in world_from_camera:
        right, down, ahead, position = pose[:3].T
        shape = np.array([lens.size[0], lens.size[1], lens.focal[0]])
        rows.append([*np.stack([down, right, -ahead, position, shape], axis=1).ravel(), 1.0, 10.0])
    np.save(path, np.array(rows))


def write_colmap(folder: Path, images: Sequence[Path], world_from_camera: Poses, lens: Lens) -> None:
    """A sparse model with an OPENCV camera."""
    values = (*lens.focal, *lens.center, *lens.radial[:2], *lens.tangential)
    photographs = {}
    for number, (name, pose) in enumerate(zip(names_below(images), world_from_camera, strict=True), start=1):
        matrix = np.linalg.inv(pose)
        x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True).tolist()
        tx, ty, tz = matrix[:3, 3].tolist()
        photographs[number] = colmap.PosedImage(name, 1, (w, x, y, z), (tx, ty, tz))
    colmap.write(colmap.Model({1: colmap.Camera("OPENCV", lens.size, values)}, photographs), folder)


def write_wall(folder: Path, num_views: int = 6, size: int = 64) -> None:
    """Photographs of a coloured wall with cameras in ``transforms.json``: the smallest capture."""
    (folder / "images").mkdir(parents=True)
    texture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (24, 24, 3), dtype=np.uint8))
    wall = texture.resize((4 * size, 4 * size), Image.Resampling.BICUBIC)
    images = [folder / "images" / f"{view:02d}.png" for view in range(num_views)]
    poses = np.tile(np.eye(4), (num_views, 1, 1))
    for view, image in enumerate(images):
        # Cameras move along the wall at a distance of 2 focal lengths: 1 is half an image.
        left = size + 4 * view
        wall.crop((left, size, left + size, 2 * size)).save(image)
        poses[view, 0, 3] = 2 * left / size
    lens = Lens((size, size), (size, size), (size / 2, size / 2))
    write_transforms(folder / "transforms.json", images, [*poses], lens)
