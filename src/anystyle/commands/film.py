"""Film a stylized scene again, along another path."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.launch import job_folder, launch
from anystyle.cli.run import run, words_of
from anystyle.contracts import Renderer
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.pipeline.beside import saved_cameras, with_cameras, with_stored_cameras
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.film import Film
from anystyle.pipeline.load import default_device
from anystyle.pipeline.options import ViewOptions
from anystyle.pipeline.request import file_of
from anystyle.pipeline.saved import PAINTED, cameras_of, made_at, read_unturned, tidied
from anystyle.registry.build import build
from anystyle.registry.compose import options

KEYS = """\
  video.path=smooth|orbit|camera_path.json        video.frames=72 video.fps=24 video.height=1080 video.stills=0
"""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle film``; all other words are Hydra's."""
    flags = new_parser("film", "Film a stylized scene again, along another path.", KEYS)
    flags.formatter_class = argparse.RawDescriptionHelpFormatter
    flags.add_argument("scene", type=Path, help="a folder of anystyle stylize, or a file of Gaussians")
    flags.add_argument("--style", help="of several styles in it, the title of one (default: the last)")
    flags.add_argument("--out", default="film", help="the film's folder, or a file.mp4 (default: %(default)s)")
    return flags


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle film``."""

    def command() -> None:
        arguments, rest = split(parser(), words_of(words))
        launch("film", lambda config: film(config, arguments), rest)

    run(command)


def film(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Film what the arguments name as a configuration says."""
    video, splat, render = Film(options(config, "video")), options(config, "splat"), build(Renderer, config.renderer)
    path = file_of(arguments.scene)
    given = read_unturned(path, splat)
    saved = with_stored_cameras(in_axes("opencv", given), path, splat.folder, given.up)
    size = made_at(path)
    if not saved.names:
        side = min(size) if size else PAINTED
        cameras, sources, _ = cameras_of(path, saved, ViewOptions(), splat, render, 2, side, given.up)
        saved = replace(saved, cameras=cameras, names=tuple(each.name for each in sources), photographed=False)
    elif size is not None:  # photographs may be larger than the views that the scene was made of
        saved = with_cameras(saved, saved_cameras(saved), size)
    titles = [title for title, _ in saved.styles]
    quoted = f"“{arguments.style}”"  # as a text is titled
    title = quoted if quoted in titles else arguments.style or titles[-1]
    if title not in titles:
        raise UserError(f"--style {arguments.style!r}: there are {', '.join(map(repr, titles))}")
    gaussians = tidied(dict(saved.styles)[title], saved.cameras, render, splat).to(default_device())
    saved, out = replace(saved, styles=((title, gaussians),)), job_folder(arguments.out)
    print(f"film {video.line(saved.cameras)} …", file=sys.stderr, flush=True)
    if out.suffix.lower() == ".mp4":
        out.parent.mkdir(parents=True, exist_ok=True)
        video.write(saved, out, render)
    else:
        with atomic_directory(out) as temporary:
            video.write(saved, temporary / "video.mp4", render)
    print(f"the film is {out if out.is_file() else out / 'video.mp4'}")


if __name__ == "__main__":
    main()
