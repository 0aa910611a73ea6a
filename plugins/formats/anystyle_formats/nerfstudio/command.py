"""``anystyle nerfstudio``: scenes as runs of nerfstudio, and its camera paths."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from anystyle.cli.arguments import new_parser, parse, split, subcommand
from anystyle.contracts import Command, Renderer
from anystyle.data.names import distinct
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory, write_json
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.load import default_device
from anystyle.pipeline.options import ViewOptions
from anystyle.pipeline.saved import read_saved
from anystyle.pipeline.splats import cameras_of
from anystyle.pipeline.styles import slug
from anystyle.registry.build import build
from anystyle.registry.compose import compose, options
from anystyle.types import Gaussians, StyledScene
from anystyle_formats.nerfstudio.camera_path import CameraTrajectory, keyframes_of, read_camera_path
from anystyle_formats.nerfstudio.export import write_experiment
from anystyle_formats.nerfstudio.run_folder import read_run

SUBCOMMANDS = {
    "export": "from a scene to data folders and runs that ns-viewer and ns-render open, one for each style",
    "path": "from a camera path of its viewer to a file of keyframes",
}
MAX_KEYFRAMES = 10_000


def export_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle nerfstudio export``; other arguments are Hydra's, such as ``renderer=cpu``."""
    flags = new_parser("nerfstudio export", "Write a scene as data and runs of nerfstudio.")
    flags.add_argument("scene", type=Path, help="a folder of anystyle stylize, or a file of Gaussians")
    flags.add_argument("--out", type=Path, required=True, help="the folder to write")
    flags.add_argument("--side", type=int, default=512, help="shorter side of the images (default: %(default)s)")
    return flags


@torch.no_grad()
def export(words: Sequence[str]) -> None:
    """Write a data folder and a run for each style of a scene."""
    arguments, overrides = split(export_parser(), words)
    config = compose("stylize", overrides)
    renderer, splat = build(Renderer, config.renderer), options(config, "splat")
    saved = read_saved(arguments.scene, splat.up, activated=splat.activated)
    views = ViewOptions(short_side=arguments.side)
    cameras, sources, origin = cameras_of(arguments.scene, saved, views, splat, 2, arguments.side)
    device, names = default_device(), tuple(source.name for source in sources)
    experiments = distinct([slug(title) for title, _ in saved.styles], "-")
    final, written = arguments.out.absolute(), []
    with atomic_directory(arguments.out, experiments) as folder:
        for experiment, (title, gaussians) in zip(experiments, saved.styles, strict=True):
            scene = StyledScene(((title, gaussians.to(device)),), cameras.to(device), names, saved.notes, title)
            written.append(write_experiment(scene, folder, final, experiment, renderer))
    print(f"{len(written)} runs of nerfstudio in {arguments.out}, {len(names)} cameras {origin}")
    for path in written:
        print(f"ns-viewer --load-config {final / path}")


def path_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle nerfstudio path``."""
    flags = new_parser("nerfstudio path", "Turn a camera path of nerfstudio's viewer into a file of keyframes.")
    flags.add_argument("path", type=Path, help="a file that the viewer saved, in camera_paths/")
    flags.add_argument("--run", type=Path, help="the folder of the run it is of (default: one that export wrote)")
    flags.add_argument("--out", type=Path, required=True, help="the file to write")
    return flags


def path(words: Sequence[str]) -> None:
    """Write a file of keyframes in the coordinates that the run's scene has when it is read."""
    arguments = parse(path_parser(), words)
    flight = placed(read_camera_path(arguments.path), arguments.run)
    if len(flight.times) > MAX_KEYFRAMES:
        raise UserError(f"{arguments.path} has {len(flight.times)} frames; at most {MAX_KEYFRAMES} are taken")
    write_json(arguments.out, keyframes_of(flight))
    print(f"{arguments.out}: {len(flight.times)} frames, {float(flight.times[-1]):.1f} s")


def placed(flight: CameraTrajectory, run: Path | None) -> CameraTrajectory:
    """A path in OpenCV's axes, as the scene of its run is read; ``None`` is a run in its data's coordinates, z up."""
    cameras, up = flight.cameras, "z"
    if run is not None:
        frame = read_run(run)
        poses = frame.data_from_model.poses(cameras.world_from_camera)
        cameras, up = replace(cameras, world_from_camera=poses), frame.up
    nothing = Gaussians(*(torch.zeros(1, 0, *shape) for shape in ((3,), (4,), (3,), (), (1, 3))))
    return flight._replace(cameras=in_axes("opencv", StyledScene((("", nothing),), cameras, up=up)).cameras)


class Nerfstudio(Command):
    """Scenes as data and runs of nerfstudio, and camera paths of its viewer."""

    def __call__(self, words: Sequence[str]) -> None:
        name = subcommand("nerfstudio", self.__doc__, SUBCOMMANDS, words)
        if name is not None:
            {"export": export, "path": path}[name](words[1:])
