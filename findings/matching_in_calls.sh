#!/usr/bin/env bash
# Features matched in several calls, as for a line of progress: pycolmap indexes them anew in each.
#
# `match_image_pairs` and the matchers like it search by an index of each image's descriptors, which is kept within a
# call and dropped at its end. In pycolmap 4.2.1, on a processor, a list of pairs given in parts has the same matches, to
# the bit, for more work: whoever wants progress, or ends early, gives parts that are large.
# Seen: 12 images of 2000 descriptors each, all 66 pairs, one thread, CPU time of parts of 11 pairs 1.5 and of single
# pairs 2.4 times that of one call.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pycolmap==4.2.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import tempfile
import time
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

IMAGES, SIZE = [f"{number:02d}.png" for number in range(12)], 2000
PAIRS = list(combinations(IMAGES, 2))


def write(path):
    """Images that show the same 2000 points, with noise in their descriptors."""
    generator = np.random.default_rng(0)
    shared = generator.integers(0, 256, (SIZE, 128))
    with pycolmap.Database.open(path) as database:
        lens = pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[500, 320, 240, 0])
        camera = database.write_camera(lens)
        for name in IMAGES:
            image = database.write_image(pycolmap.Image(name=name, camera_id=camera))
            places = generator.uniform(0, [640, 480], (SIZE, 2))
            database.write_keypoints(image, np.c_[places, np.ones(SIZE), np.zeros(SIZE)].astype(np.float32))
            data = np.clip(shared + generator.integers(-3, 4, shared.shape), 0, 255).astype(np.uint8)
            kind = pycolmap.FeatureExtractorType.SIFT
            database.write_descriptors(image, pycolmap.FeatureDescriptors(data=data, type=kind))


def matched(part):
    """CPU seconds, and the matches, of all pairs in calls of so many."""
    with tempfile.TemporaryDirectory() as folder:
        path, listed = Path(folder) / "database.db", Path(folder) / "pairs.txt"
        write(path)
        matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.ImportedPairingOptions()
        matching.num_threads, matching.use_gpu, matching.skip_geometric_verification = 1, False, True
        pairing.match_list_path = listed
        verification, device = pycolmap.TwoViewGeometryOptions(), pycolmap.Device.cpu
        begun = time.process_time()
        for start in range(0, len(PAIRS), part):
            listed.write_text("".join(f"{first} {second}\n" for first, second in PAIRS[start : start + part]))
            pycolmap.match_image_pairs(path, matching, pairing, verification, device)
        seconds = time.process_time() - begun
        with pycolmap.Database.open(path) as database:
            matches = database.read_all_matches()
        return seconds, {pair: found.tobytes() for pair, found in zip(*matches, strict=True)}


pycolmap.logging.minloglevel = 3
whole, parts, single = (matched(part) for part in (len(PAIRS), 11, 1))
print(f"one call 1, calls of 11 pairs {parts[0] / whole[0]:.1f}, of one {single[0] / whole[0]:.1f}")
assert len(whole[1]) == len(PAIRS) and whole[1] == parts[1] == single[1]
assert single[0] > 1.5 * whole[0]
PYTHON
echo "as described"
