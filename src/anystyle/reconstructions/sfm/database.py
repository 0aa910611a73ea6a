"""Features and verified matches of photographs, in COLMAP's database."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Float

from anystyle.reconstructions.sfm.matches import Features, VerifiedPair
from anystyle.reconstructions.sfm.photographs import Enlargement, Photograph

if threading.current_thread() is threading.main_thread():
    # Its import lets signals print a native stack; Python's own handlers are put back.
    for _number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(_number, signal.getsignal(_number) or signal.SIG_DFL)


@contextmanager
def silent() -> Iterator[None]:
    """Let COLMAP say only what ends the process; also a decorator."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


Array = np.ndarray
LENS_MODEL = "SIMPLE_RADIAL"
DEFAULT_FOCAL = 1.2
"""Guess of a focal length of which nothing is known, in longer sides of the photograph."""
PAIRS_AT_ONCE = 16
"""Pairs that are handed to COLMAP at once."""


@silent()
def write_features(
    path: Path,
    photographs: Sequence[Photograph],
    enlarged: Sequence[Enlargement],
    *,
    num_features: int,
    threads: int,
    tick: Callable[[], None],
) -> list[Features]:
    """Find SIFT features in photographs and write them with a guess of their lenses; images are named by their index.

    Args:
        path: Of the database.
        photographs: Of one capture.
        enlarged: How each is scaled before.
        num_features: The strongest that are kept of each.
        threads: How many to use.
        tick: Called after each photograph.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = threads
    options.use_gpu = False
    options.sift.max_num_features = num_features
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    features: list[Features] = []
    database = pycolmap.Database.open(path)
    try:
        rigs = _write_lenses(database, photographs, enlarged)
        for index, (photograph, scaled) in enumerate(zip(photographs, enlarged, strict=True)):
            rig = rigs[photograph.lens, photograph.size]
            image = pycolmap.Image(name=str(index), camera_id=rig.ref_sensor_id.id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig.rig_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            keypoints, descriptors = extractor.extract_from_uint8_array(np.array(scaled.apply(photograph)))
            matrix = pycolmap.keypoints_to_matrix(keypoints)
            database.write_keypoints(image.image_id, matrix)
            database.write_descriptors(image.image_id, descriptors)
            features.append(Features(matrix, _normalised(descriptors.data)))
            tick()
    finally:
        database.close()
    return features


@silent()
def match(
    path: Path, pairs: Sequence[tuple[int, int]], *, seed: int, threads: int, tick: Callable[[], None]
) -> list[VerifiedPair]:
    """Match features of pairs, verify the matches by epipolar geometry, and write both into the database.

    Args:
        path: Of the database, with features.
        pairs: Indices of photographs.
        seed: Of RANSAC.
        threads: How many to use.
        tick: Called after every :data:`PAIRS_AT_ONCE` pairs.

    Returns:
        The pairs that passed.
    """
    options = pycolmap.FeatureMatchingOptions()
    options.num_threads = threads
    options.use_gpu = False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    listed = pycolmap.ImportedPairingOptions()
    listed.match_list_path = path.with_suffix(".pairs")
    for start in range(0, len(pairs), PAIRS_AT_ONCE):
        names = "".join(f"{first} {second}\n" for first, second in pairs[start : start + PAIRS_AT_ONCE])
        listed.match_list_path.write_text(names)
        pycolmap.match_image_pairs(path, options, listed, verification, pycolmap.Device.cpu)
        tick()
    return verified_pairs(path)


def verified_pairs(path: Path) -> list[VerifiedPair]:
    """The verified pairs of a database."""
    database = pycolmap.Database.open(path)
    try:
        index = {image.image_id: int(image.name) for image in database.read_all_images()}
        pixels = {number: database.read_keypoints(number)[:, :2].astype(np.float64) for number in index}
        verified = []
        for pair, geometry in zip(*database.read_two_view_geometries(), strict=True):
            ids = pycolmap.pair_id_to_image_pair(pair)
            matches = geometry.inlier_matches
            if len(matches):
                matched = np.stack([pixels[image][matches[:, side]] for side, image in enumerate(ids)])
                verified.append(VerifiedPair(index[ids[0]], index[ids[1]], matched))
    finally:
        database.close()
    return sorted(verified, key=lambda pair: (pair.first, pair.second))


def _write_lenses(
    database: pycolmap.Database, photographs: Sequence[Photograph], enlarged: Sequence[Enlargement]
) -> dict[tuple[str, tuple[int, int]], pycolmap.Rig]:
    """One camera for every lens and size."""
    rigs: dict[tuple[str, tuple[int, int]], pycolmap.Rig] = {}
    for photograph, scaled in zip(photographs, enlarged, strict=True):
        group = photograph.lens, photograph.size
        if group in rigs:
            continue
        height, width = scaled.scaled
        known = photograph.focal_length
        focal = DEFAULT_FOCAL * max(height, width) if known is None else known * scaled.factors[0]
        camera = pycolmap.Camera.create_from_model_name(0, LENS_MODEL, focal, width, height)
        camera.has_prior_focal_length = known is not None
        camera.camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(camera.sensor_id)
        rig.rig_id = database.write_rig(rig)
        rigs[group] = rig
    return rigs


def _normalised(descriptors: Array) -> Float[Array, "N 128"]:
    values = descriptors.astype(np.float32)
    return values / np.linalg.norm(values, axis=1, keepdims=True).clip(1e-6)
