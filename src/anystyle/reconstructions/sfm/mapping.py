"""COLMAP's two mappers, incremental and global, on one database of matches."""

import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from anystyle.reconstructions.sfm.database import silent
from anystyle.reconstructions.sfm.model import Lens, SparseModel, Tracks
from anystyle.reconstructions.sfm.photographs import Enlargement

LEAST_INLIERS = 15
"""Points by which the incremental mapper tries a view; whether it is well held is judged afterwards."""
FEWEST_VIEWS = 3
"""Smaller models are dropped: two views tell nothing of each other that a third could contradict."""


@silent()
def map_incrementally(
    database: Path, enlarged: Sequence[Enlargement], *, seed: int, threads: int, tick: Callable[[], None]
) -> list[SparseModel]:
    """Models by adding one view after the other, the largest first.

    Args:
        database: With verified matches; it is not changed.
        enlarged: How the photographs were enlarged for it.
        seed: Of RANSAC.
        threads: How many to use.
        tick: Called after each view.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = threads
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.min_model_size = FEWEST_VIEWS
    options.extract_colors = False
    options.mapper.init_min_num_inliers = 50
    options.mapper.abs_pose_min_num_inliers = LEAST_INLIERS
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copy(database, Path(folder) / "database.db")
        models = pycolmap.incremental_mapping(copy, folder, folder, options, next_image_callback=tick)
    return _sorted(models, enlarged)


@silent()
def map_globally(database: Path, enlarged: Sequence[Enlargement], *, seed: int, threads: int) -> list[SparseModel]:
    """Models by averaging all rotations and then solving for all positions at once (GLOMAP), the largest first.

    Args:
        database: With verified matches; it is not changed.
        enlarged: How the photographs were enlarged for it.
        seed: Of RANSAC and of the first guess of positions.
        threads: How many to use.
    """
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = threads
    options.random_seed = options.mapper.random_seed = seed
    options.min_model_size = FEWEST_VIEWS
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copy(database, Path(folder) / "database.db")
        models = pycolmap.global_mapping(copy, folder, folder, options)
    return _sorted(models, enlarged)


def _sorted(mapped: dict[int, pycolmap.Reconstruction], enlarged: Sequence[Enlargement]) -> list[SparseModel]:
    models = [_plain(one, enlarged) for one in mapped.values()]
    return sorted(models, key=lambda model: (model.num_registered, len(model.points)), reverse=True)


def _plain(model: pycolmap.Reconstruction, enlarged: Sequence[Enlargement]) -> SparseModel:
    """COLMAP's reconstruction as arrays, in pixels of the photographs; the images' names are the views' numbers."""
    poses = np.full((len(enlarged), 4, 4), np.nan)
    lenses: list[Lens | None] = [None] * len(enlarged)
    views: dict[int, int] = {}
    for number, image in model.images.items():
        view = int(image.name)
        lenses[view] = _lens(model.cameras[image.camera_id], enlarged[view])
        if image.has_pose:
            views[number] = view
            poses[view] = np.eye(4)
            poses[view, :3] = image.cam_from_world().inverse().matrix()
    points = [point for point in model.points3D.values() if point.track.length() > 0]
    rows = [
        (index, views[seen.image_id], *model.images[seen.image_id].points2D[seen.point2D_idx].xy)
        for index, point in enumerate(points)
        for seen in point.track.elements
        if seen.image_id in views
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    view = table[:, 1].astype(np.int64)
    factors = np.array([one.factors for one in enlarged])
    positions = np.array([point.xyz for point in points], dtype=np.float64).reshape(-1, 3)
    tracks = Tracks(table[:, 0].astype(np.int64), view, table[:, 2:] / factors[view])
    return SparseModel(poses, tuple(lenses), positions, tracks)


def _lens(camera: pycolmap.Camera, enlarged: Enlargement) -> Lens:
    focal, x, y, radial = (float(value) for value in camera.params)
    across, down = enlarged.factors
    return Lens((focal / across, focal / down), (x / across, y / down), radial, enlarged.size)
