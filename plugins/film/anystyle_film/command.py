"""``anystyle film``: another film of a scene that was stylized already."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.commands._compose import job_folder, launch
from anystyle.commands._flags import new_parser, split
from anystyle.contracts import Renderer, RenderFrames, Video
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.pipeline.load import default_device
from anystyle.pipeline.saved import read_saved, with_stored_cameras
from anystyle.registry.build import build
from anystyle.registry.compose import options
from anystyle.registry.socket import Command
from anystyle.types import Cameras, Gaussians

CONF = Path(__file__).parent / "conf"
KEYS = """\
  video.kind=pinhole|stereo|equirectangular|vr180        video.path=smooth|orbit|spiral|keyframes.json
  video.frames=72 video.fps=24 video.height=1080 video.stills=0; the others: anystyle plugins video film
"""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle film``; all other words are Hydra's."""
    flags = new_parser("film", "Film a scene again: another path, in stereo, or all around.", KEYS)
    flags.formatter_class = argparse.RawDescriptionHelpFormatter
    flags.add_argument("scene", type=Path, help="a folder of anystyle stylize, or a file of Gaussians")
    flags.add_argument("--style", help="of several styles in it, the title of one (default: the last)")
    flags.add_argument("--out", default="film", help="where the film goes (default: %(default)s)")
    return flags


class FilmCommand(Command):
    """Film a stylized scene again: another path, in stereo, or all around."""

    def __call__(self, words: Sequence[str]) -> None:
        arguments, rest = split(parser(), list(words))
        launch("film", lambda config: film(config, arguments), rest, CONF)


def film(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Film what the arguments name as a configuration says."""
    video, renderer = build(Video, config.video), build(Renderer, config.renderer)
    splat = options(config, "splat")
    saved = read_saved(arguments.scene, splat.up, activated=splat.activated)
    saved = with_stored_cameras(saved, arguments.scene, splat.folder)
    if not saved.names:
        raise UserError(f"{arguments.scene} has no cameras in it or beside it, and a path begins with cameras")
    titles = [title for title, _ in saved.styles]
    if arguments.style not in (None, *titles):
        raise UserError(f"--style {arguments.style!r}: there are {', '.join(map(repr, titles))}")
    gaussians = dict(saved.styles)[arguments.style or titles[-1]].to(default_device())
    folder = job_folder(arguments.out)
    with atomic_directory(folder) as temporary:
        video.write(gaussians, saved.cameras.to(default_device()), rendering(renderer, gaussians), temporary)
    print(f"the film is {folder / 'video.mp4'}")


def rendering(renderer: Renderer, gaussians: Gaussians) -> RenderFrames:
    """How a renderer shows a scene, image by image."""

    @torch.no_grad()
    def render(cameras: Cameras) -> Iterator[Float[Tensor, "3 H W"]]:
        for view in range(cameras.intrinsics.shape[1]):
            yield renderer(gaussians, cameras.select([view])).color[0, 0].cpu()

    return render
