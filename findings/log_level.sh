#!/usr/bin/env bash
# pycolmap 4.2.1: bundle_adjustment sets the log's level back, for all calls that follow.
#
# `pycolmap.logging.minloglevel = 3` (FATAL) silences COLMAP, whose every stage else writes lines to standard error.
# `pycolmap.bundle_adjustment` leaves it at 0: it writes its own two lines, though `print_summary` is off, and mapping,
# triangulation and matching after it write theirs. `create_default_bundle_adjuster(...).solve()` does the same
# adjustment, to 1e-6, and leaves the level alone.
# Seen: a synthetic model of five images and fifty points, with noise of a pixel.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pycolmap==4.2.1 numpy==2.4.6
env/bin/python - 2> log.txt <<'PYTHON'
import numpy as np
import pycolmap

dataset = pycolmap.SyntheticDatasetOptions()
dataset.num_rigs, dataset.num_cameras_per_rig, dataset.num_frames_per_rig, dataset.num_points3D = 1, 1, 5, 50
options = pycolmap.BundleAdjustmentOptions()
options.print_summary = False
options.ceres.solver_options.num_threads = 1


def adjusted(model, adjust):
    pycolmap.logging.minloglevel = 3
    adjust(model)
    return pycolmap.logging.minloglevel, [image.cam_from_world().matrix() for _, image in sorted(model.images.items())]


def by_adjuster(model):
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images:
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


given = pycolmap.synthesize_dataset(dataset)
noise = pycolmap.SyntheticNoiseOptions()
noise.point2D_stddev = 1.0
pycolmap.synthesize_noise(noise, given)
ways = {"bundle_adjustment": lambda model: pycolmap.bundle_adjustment(model, options), "adjuster": by_adjuster}
found = {}
for name, way in ways.items():
    found[name] = adjusted(pycolmap.Reconstruction(given), way)
    print(f"{name}: the level is {found[name][0]}")
assert found["bundle_adjustment"][0] == 0 and found["adjuster"][0] == 3
print(f"largest difference {np.abs(np.subtract(found['adjuster'][1], found['bundle_adjustment'][1])).max():.1e}")
assert np.allclose(found["adjuster"][1], found["bundle_adjustment"][1], atol=1e-6)
PYTHON
grep "Global bundle adjustment" log.txt
echo "as described"
