"""``anystyle benchmark geometry``: depth and cameras of a track's views, and the hashes of its inputs.

Cameras are found from all photographs by structure from motion, depth by stereo of them at the judged size; it is 0
where no other photograph confirms it.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import anystyle
from anystyle.cli.arguments import new_parser, parse
from anystyle.data.images import open_image, to_tensor
from anystyle.errors import UserError, one_line
from anystyle.evaluation.comparisons import write_cameras
from anystyle.io.atomic import atomic_path
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.read import read
from anystyle.pipeline.stages import Stages
from anystyle_benchmark.ours import judged_cameras
from anystyle_benchmark.track import Inputs, SceneEntry


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark geometry``."""
    flags = new_parser(
        "benchmark geometry",
        "Compute depth and cameras of a track's views, for metrics of consistency, in the folders of `geometry` that "
        "its scenes name.",
    )
    flags.add_argument("track", type=Path, help="a track.toml, its inputs beside it")
    flags.add_argument("--scenes", metavar="A,B", help="only these scenes; '' for none")
    flags.add_argument("--lock", action="store_true", help="write the hashes of all inputs into the track's file")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark geometry``."""
    arguments = parse(parser(), args)
    if not arguments.track.is_file():
        raise UserError(f"there is no file {arguments.track}; give the track.toml of your own track")
    inputs = Inputs(str(arguments.track))
    chosen = None if arguments.scenes is None else list(filter(None, arguments.scenes.split(",")))
    for scene in inputs.track.scenes if chosen is None else [inputs.scene(name) for name in chosen]:
        if scene.geometry is not None:
            make_geometry(inputs, scene, inputs.path(scene.geometry))
            print(f"{scene.name}: depth and cameras of {len(scene.views)} views in {inputs.path(scene.geometry)}")
    if arguments.lock:
        lock(inputs)
        print(f"{arguments.track} has the hashes of its inputs")


@torch.no_grad()
def make_geometry(inputs: Inputs, scene: SceneEntry, folder: Path) -> None:
    """Write the judged views' depth along z, in half precision, and cameras."""
    photographs, (height, width) = inputs.photographs(scene), inputs.size(scene)
    files = [str(path) for path in photographs.values()]
    try:
        found = read(files, anystyle.load().backbone, ViewOptions(), PoseOptions("sfm"), None, Stages())
    except UserError as error:
        raise UserError(f"scene {scene.name}: {one_line(error)}; or leave out `geometry`") from None
    from anystyle_captures.stereo import plane_sweep  # importable once the catalog has loaded one of its plugins

    if found.cameras is None or len(found.sources) < len(files):
        raise UserError(
            f"scene {scene.name}: cameras of {len(found.sources)} of {len(files)} photographs are found; "
            "give photographs in smaller steps, or leave out `geometry`"
        )
    cameras = judged_cameras(found.cameras, found.sources, list(photographs), (height, width))
    pictures = [open_image(path).resize((width, height), Image.Resampling.LANCZOS) for path in photographs.values()]
    names = [source.name for source in found.sources]
    points = None if found.points is None else [found.points[names.index(name)] for name in photographs]
    stereo = plane_sweep(torch.stack([to_tensor(picture) for picture in pictures]), cameras, points=points)
    depth = torch.where(stereo.support > 0, stereo.depth, 0)  # another photograph's depth agrees
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [list(photographs).index(view) for view in scene.views]
    with atomic_path(folder / "cameras.npz") as temporary:
        write_cameras(temporary, scene.views, cameras.select(chosen))
    for view, index in zip(scene.views, chosen, strict=True):
        with atomic_path(folder / f"{view}.npy") as temporary:
            np.save(temporary, depth[index].numpy().astype(np.float16))


def lock(inputs: Inputs) -> None:
    """Write the hashes of a track's inputs to the end of its file, in place of earlier ones."""
    text = inputs.file.read_text(encoding="utf-8").split("\n[sha256]\n")[0].rstrip()
    hashes = "".join(f'"{name}" = "{value}"\n' for name, value in inputs.computed_hashes().items())
    with atomic_path(inputs.file) as temporary:
        temporary.write_text(f"{text}\n\n[sha256]\n{hashes}", encoding="utf-8")
