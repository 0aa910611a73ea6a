"""Depth and cameras of a track's views: ``python -m anystyle_benchmark.make_geometry TRACK.toml``.

Cameras are found from all photographs by structure from motion, depth by stereo of them at the judged size; it is 0
where no other photograph confirms it. Scenes that name a folder of ``geometry`` get theirs; ``--lock`` writes the
hashes of all inputs into the track, after what it says.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import anystyle
from anystyle.commands._run import run
from anystyle.data.images import open_image, to_tensor
from anystyle.errors import UserError
from anystyle.evaluation.comparisons import write_cameras
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.read import read
from anystyle.pipeline.stages import Stages
from anystyle_benchmark.ours import judged_cameras
from anystyle_benchmark.track import Inputs, SceneEntry

SUPPORT = 1
"""Depth is known where that of so many other photographs agrees."""


@torch.no_grad()
def make_geometry(inputs: Inputs, scene: SceneEntry) -> None:
    """Write the judged views' depth along z, in half precision, and cameras."""
    photographs, (height, width) = inputs.photographs(scene), inputs.size(scene)
    files = [str(path) for path in photographs.values()]
    found = read(files, anystyle.load().backbone, ViewOptions(), PoseOptions("sfm"), None, Stages())
    from anystyle_captures.stereo import plane_sweep  # the folder of a plugin is known once one of it was asked for

    if found.cameras is None or len(found.sources) < len(files):
        raise UserError(f"{scene.name}: cameras of {len(found.sources)} of {len(files)} photographs are found")
    cameras = judged_cameras(found.cameras, found.sources, list(photographs), (height, width))
    pictures = [open_image(path) for path in photographs.values()]
    small = [picture.resize((width, height), Image.Resampling.LANCZOS) for picture in pictures]
    names = [source.name for source in found.sources]
    points = None if found.points is None else [found.points[names.index(name)] for name in photographs]
    stereo = plane_sweep(torch.stack([to_tensor(picture) for picture in small]), cameras, points=points)
    depth = torch.where(stereo.support >= SUPPORT, stereo.depth, 0)
    folder = inputs.path(str(scene.geometry))
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [list(photographs).index(view) for view in scene.views]
    write_cameras(folder / "cameras.npz", scene.views, cameras.select(chosen))
    for view, index in zip(scene.views, chosen, strict=True):
        np.save(folder / f"{view}.npy", depth[index].numpy().astype(np.float16))


def lock(track: Path) -> None:
    """Write the hashes of a track's inputs to the end of its file."""
    text = track.read_text().split("\n[sha256]\n")[0].rstrip()
    track.write_text(text + "\n")
    hashes = Inputs(str(track)).hashes
    track.write_text(f"{text}\n\n[sha256]\n" + "".join(f'"{name}" = "{value}"\n' for name, value in hashes.items()))


def main(words: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("track", type=Path, help="a track.toml, its inputs beside it")
    parser.add_argument("--scenes", nargs="*", help="some of the scenes; no name: none")
    parser.add_argument("--lock", action="store_true", help="write the hashes of all inputs into the track")
    given = parser.parse_args(words)
    inputs = Inputs(str(given.track))
    names = [scene.name for scene in inputs.track.scenes] if given.scenes is None else given.scenes
    for name in names:
        scene = inputs.scene(name)
        if scene.geometry is not None:
            make_geometry(inputs, scene)
    if given.lock:
        lock(given.track)


if __name__ == "__main__":
    run(main)
