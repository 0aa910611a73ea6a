"""Cameras refined by bundle adjustment of the features that photographs share."""

import logging
import tempfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.transforms import nearest_rotation, similarity_of_cameras
from anystyle.types import Cameras, OnProgress, no_progress
from anystyle_captures.masks import Masks
from anystyle_captures.sfm.colmap import MAPPING_THREADS, match
from anystyle_captures.sfm.model import Photograph, SearchOptions, ViewGraph

if TYPE_CHECKING:
    import pycolmap

logger = logging.getLogger(__name__)
ERRORS = 64.0, 16.0, 4.0
"""Largest errors of features, of one adjustment after the other, in pixels of photographs whose longer side has 512 or
more. Matches are verified without cameras, so that the first may be off by degrees."""
ONE_LENS = 0.02
"""Largest standard deviation of the logarithms of one lens's focal lengths, of which a network predicts one a view."""
EXACT = 0.2
"""Distance of features from where cameras have them, in pixels searched, by which these need no adjustment: of nine
captures' cameras seven have 0.11 to 0.19, and 0.26 to 1.2 where each is turned by 0.1° and moved by 0.2 %."""
LOWER = 0.9
"""Largest ratio of that distance after an adjustment to before with which it is taken. Of six captures the ratio was
0.97 to 1.05 for exact cameras, and 0.55 to 0.88 for adjusted focal lengths where those given were off by 20 %."""


def adjusted(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    masks: Masks | None,
    *,
    seed: int = 0,
    on_progress: OnProgress = no_progress,
) -> Cameras | None:
    """Cameras that agree better with the features that photographs share, in the frame and unit of those given.

    Bundle adjustment (Triggs et al. 2000) by COLMAP of poses, and of focal lengths, too, where poses alone agree less:
    each time again while it gains. Cameras of about the same focal length have one lens. Photographs without matches
    keep their cameras.
    """
    if cameras.intrinsics[0, :, 0, 0].log().std(correction=0) < ONE_LENS:
        cameras = replace(cameras, intrinsics=cameras.intrinsics.median(1, True).values.expand_as(cameras.intrinsics))
    _, lens = torch.unique(cameras.intrinsics[0], dim=0, return_inverse=True)
    pixels = (255 * images).round().byte().movedim(1, -1).cpu().numpy()
    measured = [None] * len(images) if masks is None else list((255 * masks.measured.byte()).cpu().numpy())
    photographs = [Photograph(str(i), pixels[i], lens=str(int(lens[i])), mask=measured[i]) for i in range(len(images))]
    with tempfile.TemporaryDirectory() as name:
        folder, options, threads = Path(name), SearchOptions(seed=seed), torch.get_num_threads()
        try:
            graph = match(folder, photographs, options, threads=threads, on_progress=on_progress)
        except ImportError as error:
            logger.warning("whether the cameras are exact is not known, and they are not refined: %s", error)
            return None
        best, least = cameras, epipolar_distance(cameras, graph)
        for lenses in (False, True) if least > EXACT else ():
            found = cameras, least  # not the best, whose poses make up for a wrong lens, part by part of the capture
            while (found := _refined(folder, found[0], graph, lenses, seed))[1] < LOWER * least:
                best, least = found
    poses, given = best.world_from_camera.double(), cameras.world_from_camera[0].double()
    # Where given positions say nothing of a unit, the frame stays that of two cameras, which adjustments leave alone.
    placed = between.poses(poses) if (between := similarity_of_cameras(poses[0], given)).scale > 0 else poses
    return None if best is cameras else replace(best, world_from_camera=placed.to(cameras.world_from_camera))


def epipolar_distance(cameras: Cameras, graph: ViewGraph) -> float:
    """The Sampson distance of matches from where cameras have them, in pixels searched: the median pair's median.

    0 where no photographs match.
    """
    from kornia.geometry import epipolar

    cameras = cameras.to("cpu").resized(graph.sizes[0])
    projections = cameras.intrinsics[0].double() @ torch.linalg.inv(cameras.world_from_camera[0].double())[:, :3]
    distances = []
    for pair in graph.pairs:
        fundamental = epipolar.fundamental_from_projections(projections[[pair.first]], projections[[pair.second]])
        first, second = torch.from_numpy(pair.pixels)[:, None]
        distances.append(epipolar.sampson_epipolar_distance(first, second, fundamental, squared=False).median())
    return float(torch.stack(distances).median()) if distances else 0.0


def _refined(folder: Path, cameras: Cameras, graph: ViewGraph, lenses: bool, seed: int) -> tuple[Cameras, float]:
    """Cameras after one adjustment, and their :func:`epipolar_distance`."""
    poses, intrinsics = cameras.world_from_camera[0].cpu().double().clone(), cameras.intrinsics[0].clone()
    model = _given(folder, cameras.to("cpu").resized(graph.sizes[0]))
    for error in ERRORS:
        model = _adjusted(folder, model, error, lenses, seed)
    for image in model.images.values():
        view, camera = int(Path(image.name).stem), model.cameras[image.camera_id]
        poses[view, :3] = torch.from_numpy(image.cam_from_world().inverse().matrix())
        if lenses:
            camera.rescale(cameras.size[1], cameras.size[0])
            intrinsics[view] = torch.from_numpy(camera.calibration_matrix())
    found = replace(cameras, world_from_camera=poses[None].to(cameras.world_from_camera), intrinsics=intrinsics[None])
    return found, epipolar_distance(found, graph)


def _given(folder: Path, cameras: Cameras) -> "pycolmap.Reconstruction":
    """COLMAP's model of cameras without points; its database gets their lenses."""
    import pycolmap

    model, (height, width) = pycolmap.Reconstruction(), cameras.size
    camera_from_world = torch.linalg.inv(cameras.world_from_camera[0].double())
    rotations = nearest_rotation(camera_from_world[:, :3, :3]).numpy()
    with closing(pycolmap.Database.open(folder / "database.db")) as database:
        for image in database.read_all_images():
            view, number = int(Path(image.name).stem), image.camera_id
            if number not in model.cameras:
                lens = cameras.intrinsics[0, view].double().numpy()[[0, 1, 0, 1], [0, 1, 2, 2]]
                camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=lens, camera_id=number)
                database.update_camera(camera)
                model.add_camera_with_trivial_rig(camera)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotations[view]), camera_from_world[view, :3, 3].numpy())
            placed = pycolmap.Image(name=image.name, camera_id=number, image_id=image.image_id)
            model.add_image_with_trivial_frame(placed, pose)
    return model


def _adjusted(
    folder: Path, model: "pycolmap.Reconstruction", error: float, lenses: bool, seed: int
) -> "pycolmap.Reconstruction":
    """The model with points that its cameras see at most so many pixels from their features, and both adjusted."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = MAPPING_THREADS, seed, False
    points = options.triangulation
    points.random_seed, points.ignore_two_view_tracks = seed, False
    points.create_max_angle_error = points.continue_max_angle_error = error / 4  # degrees
    points.complete_max_reproj_error = points.merge_max_reproj_error = options.mapper.filter_max_reproj_error = error
    model = pycolmap.triangulate_points(model, folder / "database.db", folder, folder, True, options)
    adjustment, config = pycolmap.BundleAdjustmentOptions(), pycolmap.BundleAdjustmentConfig()
    adjustment.refine_focal_length, adjustment.refine_extra_params, adjustment.print_summary = lenses, False, False
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    adjustment.ceres.solver_options.num_threads = MAPPING_THREADS
    for image in model.images:
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # Not bundle_adjustment(), which sets the level of COLMAP's log back to all that it does.
    if model.points3D:
        pycolmap.create_default_bundle_adjuster(adjustment, config, model).solve()
    return model


def difference(given: Cameras, refined: Cameras) -> tuple[float, float]:
    """How far cameras moved on average, in degrees and relative to their mean distance from their centre."""
    first, second = given.world_from_camera[0].double(), refined.world_from_camera[0].double()
    # Of the chord, which is exact for small angles.
    chord = (first[:, :3, :3] - second[:, :3, :3]).flatten(1).norm(dim=1) / 8**0.5
    centers = first[:, :3, 3]
    radius = (centers - centers.mean(0)).norm(dim=1).mean().clamp_min(1e-12)
    shift = (centers - second[:, :3, 3]).norm(dim=1)
    return float(torch.rad2deg(2 * chord.clamp_max(1).asin()).mean()), float(shift.mean() / radius)
