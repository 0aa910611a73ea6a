"""COLMAP's pipeline: features, verified matches, and the models of its two mappers.

pycolmap is imported where it is used, behind Pillow: the other way round its zlib would serve Pillow and crash it.
"""

import signal
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from PIL import Image

from anystyle.errors import MissingExtra
from anystyle.types import OnProgress, Progress, no_progress
from anystyle_captures.panorama import Cut
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

if TYPE_CHECKING:
    import pycolmap

DEFAULT_FOCAL = 1.2
"""Initial focal length where nothing is known, in longer sides of the photograph."""
MAPPING_THREADS = 1
"""The solver's sums depend on it, and cameras must not depend on the machine."""
TRACKS, MIN_TRACKS, MAX_TRACKS = 9000, 180, 500
"""Tracks of features that the global mapper solves by before it triangulates all, and their bounds for a view. Films of
40 to 48 frames take 0.6 to 0.9 of the time that 500 a view take, and verdicts stay; photographs need these: of twelve
of a street with 100 each it found nothing."""
GROWTH = 1.4
"""How much larger a model has grown when all of it is adjusted again, COLMAP's own for films: with its 1.1 for
photographs the incremental mapper took 1.2 to 1.3 times as long for cameras that differ by at most 0.07°."""
CHUNK = 128
"""Pairs between two reports of progress; COLMAP indexes a photograph's features anew for each chunk that has it."""


def load_pycolmap() -> None:
    """Import pycolmap, and restore Python's signal handlers, which it replaces to print a native stack.

    Raises:
        ImportError: It is not installed.
    """
    try:
        import pycolmap
    except ImportError as error:
        needed = "pip install pycolmap (for Linux and Windows on x86-64, macOS on arm64)"
        raise MissingExtra(f"cameras from photos need pycolmap: {needed}") from error
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.getsignal(number) or signal.SIG_DFL)


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

        known = photographs[0].cut is not None
        models = [_map_incrementally(folder, options, on_view, known), _map_globally(folder, options, count, known)]
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
    threads: int = 1,
    on_progress: OnProgress = no_progress,
) -> ViewGraph:
    """Features and verified matches, written into COLMAP's database ``folder / "database.db"``."""
    load_pycolmap()
    import pycolmap

    sizes = [_search_size(photograph.searched_size, options) for photograph in photographs]
    cut = photographs[0].cut
    if cut is not None:  # one lens of one size
        sizes = [max(sizes)] * len(sizes)
    names = _import_photographs(folder, photographs, sizes)
    previews = _extract_features(folder, names, options, threads, on_progress)
    if cut is not None:
        _apply_rig(folder, cut)
    pairs = pairs_to_match(previews, ordered, len(names) // len(photographs))
    _match_pairs(folder, names, pairs, options, threads, on_progress)

    verified, features = [], [0] * len(photographs)
    with closing(pycolmap.Database.open(folder / "database.db")) as database:
        keypoints = {image: database.read_keypoints(image) for image in _ids(database, names)}
        index = {image.image_id: _photograph_of(image.name) for image in database.read_all_images()}
        for image, found in keypoints.items():
            features[index[image]] += len(found)
        for pair_id, geometry in zip(*database.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            matches = geometry.inlier_matches
            if len(matches):
                pixels = [keypoints[first][matches[:, 0], :2], keypoints[second][matches[:, 1], :2]]
                verified.append(VerifiedPair(index[first], index[second], np.stack(pixels).astype(np.float64)))
    verified.sort(key=lambda pair: (pair.first, pair.second))
    return ViewGraph([one.name for one in photographs], features, sizes, verified)


def _photograph_of(name: str) -> int:
    """The index of the photograph that a file is of."""
    return int(Path(name).stem)


def _import_photographs(folder: Path, photographs: Sequence[Photograph], sizes: Sequence[tuple[int, int]]) -> list[str]:
    """Write gray photographs in these sizes, and masks, and enter them with their lenses; the names of the files.

    Of panoramas, of which all are if one is, the views are written.
    """
    import pycolmap

    path = folder / "database.db"
    # COLMAP shares a camera among the images of a folder; images are named by their index.
    lenses = list(dict.fromkeys((photograph.lens, photograph.size) for photograph in photographs))
    focals: dict[str, float | None] = {}
    masked = any(one.mask is not None for one in photographs)
    for index, (photograph, (height, width)) in enumerate(zip(photographs, sizes, strict=True)):
        cut, whole = photograph.cut, Image.fromarray(photograph.pixels)
        mask = Image.new("L", whole.size, 255) if photograph.mask is None else Image.fromarray(photograph.mask)
        focal = None if photograph.focal_length is None else photograph.focal_length * width / photograph.size[1]
        for part in range(1 if cut is None else len(cut.names)):
            name = f"{lenses.index((photograph.lens, photograph.size)) if cut is None else part}/{index:06d}.pnm"
            focals[name] = focal if cut is None else cut.focal(width)
            image = (whole if cut is None else cut.view(part, whole)).convert("L")
            if image.size != (width, height):
                image = image.resize((width, height), Image.Resampling.LANCZOS)
            (folder / name).parent.mkdir(exist_ok=True)
            image.save(folder / name)
            if masked:  # COLMAP leaves out what has none, where one has
                view = mask if cut is None else cut.view(part, mask).convert("L")
                levels = np.asarray(view.resize((width, height)))
                file = folder / "masks" / f"{name}.png"
                file.parent.mkdir(parents=True, exist_ok=True)
                Image.fromarray(np.where(levels > 127, 255, 0).astype(np.uint8)).save(file)
    pycolmap.Database.open(path).close()
    pycolmap.import_images(path, folder, pycolmap.CameraMode.PER_FOLDER, list(focals), _reader(folder))
    with closing(pycolmap.Database.open(path)) as database:
        for image, focal in zip(_ids(database, list(focals)), focals.values(), strict=True):
            if focal is not None:
                camera = database.read_camera(database.read_image(image).camera_id)
                camera.focal_length, camera.has_prior_focal_length = focal, True
                database.update_camera(camera)
    return list(focals)


def _apply_rig(folder: Path, cut: Cut) -> None:
    """Tell COLMAP how the views of a panorama lie: the first is the rig, and images of one name are of one panorama."""
    import pycolmap

    cameras = []
    for part, rotation in enumerate(cut.panorama_from_view):
        camera = pycolmap.RigConfigCamera(ref_sensor=part == 0, image_prefix=f"{part}/")
        if part:
            camera.cam_from_rig = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation.T), np.zeros(3))
        cameras.append(camera)
    with closing(pycolmap.Database.open(folder / "database.db")) as database:
        pycolmap.apply_rig_config([pycolmap.RigConfig(cameras=cameras)], database)


def _reader(folder: Path) -> "pycolmap.ImageReaderOptions":
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    if (folder / "masks").is_dir():
        reader.mask_path = folder / "masks"
    reader.default_focal_length_factor = DEFAULT_FOCAL
    return reader


def _ids(database: "pycolmap.Database", names: Sequence[str]) -> list[int]:
    ids = {image.name: image.image_id for image in database.read_all_images()}
    return [ids[name] for name in names]


def _extract_features(
    folder: Path, names: Sequence[str], options: SearchOptions, threads: int, on_progress: OnProgress
) -> list[Float[np.ndarray, "_ 128"]]:
    """Write SIFT features into the database; descriptors of each photograph's largest ones."""
    import pycolmap

    path, count = folder / "database.db", len(names)
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = threads, False
    extraction.sift.max_num_features, extraction.sift.peak_threshold = options.num_features, options.min_contrast
    for start in range(0, count, threads):
        batch = names[start : start + threads]
        pycolmap.extract_features(
            path, folder, batch, pycolmap.CameraMode.PER_FOLDER, _reader(folder), extraction, pycolmap.Device.cpu
        )
        on_progress(Progress.count("features", min(start + threads, count), count))
    with closing(pycolmap.Database.open(path)) as database:
        features = [
            (database.read_keypoints(image), database.read_descriptors(image)) for image in _ids(database, names)
        ]
    return [largest_features(keypoints, descriptors.data) for keypoints, descriptors in features]


def _match_pairs(
    folder: Path,
    names: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    options: SearchOptions,
    threads: int,
    on_progress: OnProgress,
) -> None:
    """Write verified matches, of features that are nearer than others by a ratio, into the database."""
    import pycolmap

    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
    matching.num_threads, matching.use_gpu = threads, False
    for start in range(0, len(pairs), CHUNK):
        chunk = pairs[start : start + CHUNK]
        pairing.match_list_path = folder / "pairs.txt"
        pairing.match_list_path.write_text("".join(f"{names[first]} {names[second]}\n" for first, second in chunk))
        pycolmap.match_image_pairs(folder / "database.db", matching, pairing, verification, pycolmap.Device.cpu)
        on_progress(Progress.count("matches", min(start + CHUNK, len(pairs)), len(pairs)))


def _map_incrementally(
    folder: Path, options: SearchOptions, on_view: Callable[[], None], known: bool
) -> dict[int, "pycolmap.Reconstruction"]:
    """Models that grow by one view after the other; ``known`` lenses and rigs stay as they are."""
    import pycolmap

    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.num_threads = mapping.mapper.num_threads = MAPPING_THREADS
    mapping.random_seed = mapping.mapper.random_seed = mapping.triangulation.random_seed = options.seed
    mapping.min_model_size = MIN_VIEWS
    mapping.extract_colors = False
    # A view that sees too few points is not tried again by its matches: 12 of *street*'s 13 s, for no camera more.
    mapping.structure_less_registration_fallback = False
    mapping.ba_global_frames_ratio = mapping.ba_global_points_ratio = GROWTH
    mapping.mapper.init_min_num_inliers = 50
    mapping.mapper.abs_pose_min_num_inliers = options.min_inliers
    mapping.ba_refine_focal_length = mapping.ba_refine_extra_params = mapping.ba_refine_sensor_from_rig = not known
    mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = not known
    return pycolmap.incremental_mapping(folder / "database.db", folder, folder, mapping, next_image_callback=on_view)


def _map_globally(
    folder: Path, options: SearchOptions, count: int, known: bool
) -> dict[int, "pycolmap.Reconstruction"]:
    """Models by averaging all rotations and then solving for all positions at once (GLOMAP)."""
    import pycolmap

    mapping = pycolmap.GlobalPipelineOptions()
    mapping.num_threads = mapping.mapper.num_threads = MAPPING_THREADS
    mapping.random_seed = mapping.mapper.random_seed = options.seed
    mapping.min_model_size = MIN_VIEWS
    mapper, adjustment = mapping.mapper, mapping.mapper.bundle_adjustment
    mapper.track_required_tracks_per_view = min(max(TRACKS // count, MIN_TRACKS), MAX_TRACKS)
    adjustment.refine_focal_length = adjustment.refine_extra_params = adjustment.refine_sensor_from_rig = not known
    for solver in (mapper, mapper.rotation_averaging, mapper.global_positioning):
        solver.refine_sensor_from_rig = not known
    return pycolmap.global_mapping(folder / "database.db", folder, folder, mapping)


def _as_arrays(reconstruction: "pycolmap.Reconstruction", photographs: Sequence[Photograph]) -> SparseModel:
    model = SparseModel.empty(len(photographs))
    views: dict[int, int] = {}
    for image in reconstruction.images.values():
        if image.has_pose:
            view = views[image.image_id] = _photograph_of(image.name)
            if photographs[view].cut is not None and Path(image.name).parent.name != "0":
                continue
            model.world_from_camera[view] = np.eye(4)
            model.world_from_camera[view, :3] = image.cam_from_world().inverse().matrix()
            camera = reconstruction.cameras[image.camera_id]
            height, width = photographs[view].searched_size
            camera.rescale(width, height)
            model.lenses[view] = camera.params
    points = [point for point in reconstruction.points3D.values() if point.track.length() > 0]
    seen = np.zeros((len(points), len(photographs)), dtype=bool)
    for row, point in zip(seen, points, strict=True):
        row[[views[element.image_id] for element in point.track.elements if element.image_id in views]] = True
    positions = np.array([point.xyz for point in points], dtype=np.float64).reshape(-1, 3)
    return SparseModel(model.world_from_camera, model.lenses, positions, seen)
