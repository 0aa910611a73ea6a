"""COLMAP's pipeline: features, verified matches, and the models of its two mappers.

Pillow is imported before pycolmap, whose zlib would otherwise serve Pillow and crash it.
"""

import signal
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from itertools import chain, repeat
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64
from PIL import Image

import pycolmap  # isort: skip

from anystyle.types import OnProgress, Progress, no_progress
from anystyle_captures.sfm.model import (
    MIN_VIEWS,
    Photograph,
    SearchOptions,
    SparseModel,
    VerifiedPair,
    ViewGraph,
    largest_features,
    pairs_to_match,
)

if threading.current_thread() is threading.main_thread():
    # Importing pycolmap replaces signal handlers to print a native stack; restore Python's own.
    for _number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(_number, signal.getsignal(_number) or signal.SIG_DFL)
DEFAULT_FOCAL = 1.2
"""Initial focal length where nothing is known, in longer sides of the photograph."""
MAPPING_THREADS = 1
"""The solver's sums depend on it, and cameras must not depend on the machine; mapping is a tenth of the time."""
CHUNK = 16
"""Pairs between two reports of progress."""


def search(
    photographs: Sequence[Photograph], options: SearchOptions, *, ordered: bool, threads: int, on_progress: OnProgress
) -> tuple[ViewGraph, list[list[SparseModel]]]:
    """Match photographs, and map them incrementally and globally."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        graph = match(folder, photographs, options, ordered=ordered, threads=threads, on_progress=on_progress)
        if len(photographs) < MIN_VIEWS or not graph.pairs:
            return graph, []
        count = len(photographs)
        mapped = chain(range(1, count + 1), repeat(count))

        def on_view() -> None:
            on_progress(Progress.count("mapping", next(mapped), count + 1))

        models = [_map_incrementally(folder, options, on_view), _map_globally(folder, options)]
        on_progress(Progress.count("mapping", count + 1, count + 1))
    found = [[_as_arrays(model, photographs) for model in reconstructions.values()] for reconstructions in models]
    for mapper in found:
        mapper.sort(key=lambda model: (model.registered.sum(), len(model.points)), reverse=True)
    return graph, found


def _search_size(size: tuple[int, int], options: SearchOptions) -> tuple[int, int]:
    longer = max(size)
    factor = max(1.0, options.min_side / longer) if longer < options.max_side else options.max_side / longer
    return max(1, round(factor * size[0])), max(1, round(factor * size[1]))


def match(
    folder: Path,
    photographs: Sequence[Photograph],
    options: SearchOptions,
    *,
    ordered: bool = False,
    pairs: Sequence[tuple[int, int]] | None = None,
    threads: int = 1,
    on_progress: OnProgress = no_progress,
) -> ViewGraph:
    """Features and verified matches, written into COLMAP's database ``folder / "database.db"``.

    ``pairs`` are matched; those that are worth it if not given, for which it matters whether they are ``ordered``.
    """
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    sizes = [_search_size(photograph.size, options) for photograph in photographs]
    path, count = folder / "database.db", len(photographs)
    # COLMAP shares a camera among the images of a folder; images are named by their index.
    lenses = list(dict.fromkeys((photograph.lens, photograph.size) for photograph in photographs))
    names = [f"{lenses.index((one.lens, one.size))}/{index:06d}.pgm" for index, one in enumerate(photographs)]
    masks = folder / "masks"
    for name, photograph, (height, width) in zip(names, photographs, sizes, strict=True):
        (folder / name).parent.mkdir(exist_ok=True)
        gray = Image.fromarray(photograph.pixels).convert("L")
        resized = gray if gray.size == (width, height) else gray.resize((width, height), Image.Resampling.LANCZOS)
        resized.save(folder / name)
        if any(one.mask is not None for one in photographs):  # COLMAP leaves out what has none, where one has
            mask = np.full(photograph.size, 255, np.uint8) if photograph.mask is None else photograph.mask
            mask = np.asarray(Image.fromarray(mask).resize((width, height)))
            (masks / name).parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.where(mask > 127, 255, 0).astype(np.uint8)).save(masks / f"{name}.png")
    reader = pycolmap.ImageReaderOptions()
    if masks.is_dir():
        reader.mask_path = masks
    reader.default_focal_length_factor = DEFAULT_FOCAL
    pycolmap.Database.open(path).close()
    pycolmap.import_images(path, folder, pycolmap.CameraMode.PER_FOLDER, names, reader)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = threads, False
    extraction.sift.max_num_features, extraction.sift.peak_threshold = options.num_features, options.min_contrast
    with closing(pycolmap.Database.open(path)) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        for name, photograph, (_, width) in zip(names, photographs, sizes, strict=True):
            if photograph.focal_length is not None:
                camera = database.read_camera(database.read_image(ids[name]).camera_id)
                camera.focal_length = photograph.focal_length * width / photograph.size[1]
                camera.has_prior_focal_length = True
                database.update_camera(camera)
    for start in range(0, count, threads):
        batch = names[start : start + threads]
        pycolmap.extract_features(
            path, folder, batch, pycolmap.CameraMode.PER_FOLDER, reader, extraction, pycolmap.Device.cpu
        )
        on_progress(Progress.count("features", min(start + threads, count), count))

    with closing(pycolmap.Database.open(path)) as database:
        keypoints = [database.read_keypoints(ids[name]) for name in names]
        descriptors = [database.read_descriptors(ids[name]).data for name in names]
    if pairs is None:
        previews = [largest_features(*features) for features in zip(keypoints, descriptors, strict=True)]
        pairs = pairs_to_match(previews, ordered)
    matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
    matching.num_threads, matching.use_gpu = threads, False
    pairing.match_list_path = folder / "pairs.txt"
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    for start in range(0, len(pairs), CHUNK):
        batch = pairs[start : start + CHUNK]
        pairing.match_list_path.write_text("".join(f"{names[first]} {names[second]}\n" for first, second in batch))
        pycolmap.match_image_pairs(path, matching, pairing, verification, pycolmap.Device.cpu)
        on_progress(Progress.count("matches", min(start + CHUNK, len(pairs)), len(pairs)))

    index = {ids[name]: view for view, name in enumerate(names)}
    verified = []
    with closing(pycolmap.Database.open(path)) as database:
        for pair_id, geometry in zip(*database.read_two_view_geometries(), strict=True):
            first, second = (index[image] for image in pycolmap.pair_id_to_image_pair(pair_id))
            matches = geometry.inlier_matches
            if len(matches):
                pixels = [keypoints[first][matches[:, 0], :2], keypoints[second][matches[:, 1], :2]]
                verified.append(VerifiedPair(first, second, np.stack(pixels).astype(np.float64)))
    verified.sort(key=lambda pair: (pair.first, pair.second))
    return ViewGraph([one.name for one in photographs], [len(one) for one in keypoints], sizes, verified)


def motion(
    graph: ViewGraph, pair: VerifiedPair, intrinsics: Sequence[Float[np.ndarray, "3 3"]], size: tuple[int, int]
) -> Float64[np.ndarray, "3 4"] | None:
    """The motion from the first camera of a pair to the second, its translation in no unit; ``None`` if none is found.

    ``intrinsics`` of both are in pixels of photographs of height and width ``size``.
    """
    cameras = []
    for matrix, view in zip(intrinsics, (pair.first, pair.second), strict=True):
        height, width = graph.sizes[view]
        across, down = width / size[1], height / size[0]
        params = [matrix[0, 0] * across, matrix[1, 1] * down, matrix[0, 2] * across, matrix[1, 2] * down]
        cameras.append(pycolmap.Camera(model="PINHOLE", width=width, height=height, params=params))
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
    options.ransac.random_seed = 0
    matches = np.arange(pair.pixels.shape[1], dtype=np.uint32)[:, None].repeat(2, axis=1)
    found = pycolmap.estimate_calibrated_two_view_geometry(
        cameras[0], pair.pixels[0], cameras[1], pair.pixels[1], matches, options
    )
    return None if found.cam2_from_cam1 is None else found.cam2_from_cam1.matrix()


def _map_incrementally(
    folder: Path, options: SearchOptions, on_view: Callable[[], None]
) -> dict[int, pycolmap.Reconstruction]:
    """Models that grow by one view after the other."""
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.num_threads = mapping.mapper.num_threads = MAPPING_THREADS
    mapping.random_seed = mapping.mapper.random_seed = mapping.triangulation.random_seed = options.seed
    mapping.min_model_size = MIN_VIEWS
    mapping.extract_colors = False
    mapping.mapper.init_min_num_inliers = 50
    mapping.mapper.abs_pose_min_num_inliers = options.min_inliers
    return pycolmap.incremental_mapping(folder / "database.db", folder, folder, mapping, next_image_callback=on_view)


def _map_globally(folder: Path, options: SearchOptions) -> dict[int, pycolmap.Reconstruction]:
    """Models by averaging all rotations and then solving for all positions at once (GLOMAP)."""
    mapping = pycolmap.GlobalPipelineOptions()
    mapping.num_threads = mapping.mapper.num_threads = MAPPING_THREADS
    mapping.random_seed = mapping.mapper.random_seed = options.seed
    mapping.min_model_size = MIN_VIEWS
    return pycolmap.global_mapping(folder / "database.db", folder, folder, mapping)


def _as_arrays(reconstruction: pycolmap.Reconstruction, photographs: Sequence[Photograph]) -> SparseModel:
    model = SparseModel.empty(len(photographs))
    views: dict[int, int] = {}
    for image in reconstruction.images.values():
        if image.has_pose:
            view = views[image.image_id] = int(Path(image.name).stem)
            model.world_from_camera[view] = np.eye(4)
            model.world_from_camera[view, :3] = image.cam_from_world().inverse().matrix()
            camera = reconstruction.cameras[image.camera_id]
            height, width = photographs[view].size
            camera.rescale(width, height)
            model.lenses[view] = camera.params
    points = [point for point in reconstruction.points3D.values() if point.track.length() > 0]
    seen = np.zeros((len(points), len(photographs)), dtype=bool)
    for row, point in zip(seen, points, strict=True):
        row[[views[element.image_id] for element in point.track.elements if element.image_id in views]] = True
    positions = np.array([point.xyz for point in points], dtype=np.float64).reshape(-1, 3)
    return SparseModel(model.world_from_camera, model.lenses, positions, seen)
