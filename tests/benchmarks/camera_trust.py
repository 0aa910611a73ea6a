"""Whether cameras with the verdict ``good`` are right: subsets of a folder of photographs, one and two searches.

``PYTHONPATH=plugins/captures python tests/benchmarks/camera_trust.py photos/ --steps 1 2 3 --lengths 6 8 12`` takes
every STEP-th photograph, LENGTH of them, from several starts, and prints what each subset comes to. Cameras are
compared with those of ``poses_bounds.npy`` beside the folder, else with the model of all its photographs. A model is
wrong if positions err by more than 10 % of the cameras' spread (root mean square), a relative rotation by more than 5°,
or directions by more than 10° in the median.
"""

import argparse
import sys
import time
from collections import Counter
from itertools import permutations
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from PIL import Image

from anystyle.geometry.transforms import similarity_of_cameras
from anystyle_captures.sfm.model import SEARCHES, Photograph
from anystyle_captures.structure_from_motion import find_cameras


def is_wrong(found: Float64[np.ndarray, "V 4 4"], truth: Float64[np.ndarray, "V 4 4"]) -> bool:
    """Whether the poses of some views, camera to world, are those of another world."""
    first, second = torch.from_numpy(found), torch.from_numpy(truth)
    moved, pairs = similarity_of_cameras(first, second).poses(first)[:, :3, 3], [*permutations(range(len(found)), 2)]
    spread = (second[:, :3, 3] - second[:, :3, 3].mean(0)).square().sum(1).mean().sqrt()
    position = (moved - second[:, :3, 3]).square().sum(1).mean().sqrt() / spread
    steps = [np.stack([np.linalg.inv(poses[one]) @ poses[other] for one, other in pairs]) for poses in (found, truth)]
    turns = np.einsum("nij,nij->n", steps[0][:, :3, :3], steps[1][:, :3, :3])
    ways = [step[:, :3, 3] / np.linalg.norm(step[:, :3, 3], axis=1, keepdims=True) for step in steps]
    rotation = np.degrees(np.arccos(((turns - 1) / 2).clip(-1, 1))).max()
    direction = np.median(np.degrees(np.arccos((ways[0] * ways[1]).sum(1).clip(-1, 1))))
    return bool(position > 0.1 or rotation > 5 or direction > 10)


def known_cameras(folder: Path, photographs: list[Photograph]) -> Float64[np.ndarray, "V 4 4"]:
    """Poses that are stored, or those found with all photographs; NaN where there is none."""
    if not (folder.parent / "poses_bounds.npy").exists():
        return find_cameras(photographs).model.world_from_camera
    rows = np.load(folder.parent / "poses_bounds.npy")[:, :15].reshape(-1, 3, 5)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.stack([rows[:, :, 1], rows[:, :, 0], -rows[:, :, 2], rows[:, :, 3]], -1)
    return poses


def main() -> None:
    """Print a line for every subset, and sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--lengths", type=int, nargs="+", default=[6, 8, 12])
    parser.add_argument("--starts", type=int, default=3, help="subsets of each step and length")
    given = parser.parse_args()
    paths = sorted(path for path in given.folder.iterdir() if path.suffix in (".jpg", ".png"))
    photographs = []
    for path in paths:
        image = Image.open(path)
        photographs.append(Photograph.from_exif(path.name, np.asarray(image.convert("RGB")), image.getexif()))
    truth = known_cameras(given.folder, photographs)
    sums = {count: Counter() for count in (1, len(SEARCHES))}
    for step, length in ((step, length) for step in given.steps for length in given.lengths):
        last = len(paths) - step * (length - 1) - 1
        for start in np.unique(np.linspace(0, last, given.starts).round().astype(int)) if last >= 0 else ():
            views = np.arange(start, start + step * length, step)
            line, began = f"step {step}, {length} from {start}:", time.process_time()
            for count, total in sums.items():
                found = find_cameras([photographs[view] for view in views], searches=SEARCHES[:count])
                kept = found.model.registered & np.isfinite(truth[views]).all((1, 2))
                poses = found.model.world_from_camera[kept], truth[views[kept]]
                right = "" if kept.sum() < 3 else " wrong" if is_wrong(*poses) else " right"
                total.update({found.verdict.trust + right: 1, "views": int(found.model.registered.sum())})
                line += f" {found.verdict.trust}{right} {found.model.registered.sum()} of {length}"
                line += f" at {found.verdict.measures.get('searched_pixels', 0):.0f} pixels;"
            sys.stdout.write(f"{line} {time.process_time() - began:.0f} s\n")
            sys.stdout.flush()
    for count, total in sums.items():
        sys.stdout.write(f"{count} searches: {dict(sorted(total.items()))}\n")


if __name__ == "__main__":
    main()
