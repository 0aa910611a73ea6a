"""A scene in the browser, restyled while one looks; or as one HTML file that needs no network."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.commands._flags import new_parser, split
from anystyle.commands._options import Stylize, checked
from anystyle.commands._run import run, words_of
from anystyle.inference.assemble import assemble_frozen, default_device, default_poses, make_method
from anystyle.inference.encoding import encode_capture, encode_splat
from anystyle.inference.export import write_page
from anystyle.inference.options import PoseOptions
from anystyle.inference.saved import is_saved, licenses, lines, read_saved
from anystyle.inference.stages import Stages
from anystyle.reconstructions.contract import Reconstruction
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians
from anystyle.viewer.session import OpenScene, opened_scene

Render = Callable[[Gaussians, Cameras], Iterator[Float[Tensor, "3 H W"]]]


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle view``; words such as model=... are Hydra's, as those of ``anystyle stylize``."""
    flags = new_parser(
        "view",
        "Look at a scene, and give it styles: photographs, a folder of anystyle stylize, or a PLY file.",
    )
    flags.add_argument("input", type=Path, help="a folder of photographs or of results, a video, or a .ply file")
    flags.add_argument("--html", type=Path, metavar="FILE", help="write one page with all saved styles, and end")
    flags.add_argument("--host", default="127.0.0.1", help="another address lets a network in, with a token")
    flags.add_argument("--port", type=int, default=8080, help="0 takes a free one (default: %(default)s)")
    flags.add_argument(
        "--keep", type=Path, default=Path("out/view"), help="where styles and pictures are kept (default: %(default)s)"
    )
    return flags


def view(arguments: argparse.Namespace, words: list[str]) -> None:
    """Run the command."""
    if arguments.html is not None:
        saved = read_saved(arguments.input)
        title = arguments.input.resolve().stem
        write_page(arguments.html, saved.styles, saved.cameras, title=title, notes="\n".join(saved.notes))
        size = arguments.html.stat().st_size / 1e6
        print(f"{arguments.html}: {len(saved.styles)} styles, {size:.2f} MB; open it in any browser")
        return
    serve(arguments, words)


def opened(path: Path, words: list[str]) -> tuple[OpenScene, Render]:
    """What is to be looked at, and what renders it."""
    config: DictConfig = compose("stylize", words)
    stages = Stages(lambda name, note: print(f"{name} {note} …", file=sys.stderr, flush=True))
    saved = read_saved(path) if is_saved(path) else None
    with stages("load", "the model"):
        stylizer, weights = assemble_frozen(config)
        stylizer = stylizer.to(default_device())
    method, options = make_method(config, stylizer.style_encoder), checked(config, Stylize)
    notes, render = tuple(lines(licenses(weights))), partial(rendered, stylizer)
    if saved is not None:
        encoded = encode_splat(path, stylizer, options.views, options.splat, stages=stages)
        return opened_scene(encoded, method, saved if path.is_dir() else None, notes=notes), render
    reconstruction = config.get("reconstruction")
    encoded = encode_capture(
        path,
        stylizer,
        options.views,
        PoseOptions(config.poses or default_poses(config), config.poses_from),
        refined=config.refine,
        stages=stages,
        reconstruction=None if reconstruction is None else build(Reconstruction, reconstruction),
    )
    return opened_scene(encoded, method, notes=notes), render


@torch.no_grad()
def rendered(stylizer: Stylizer, gaussians: Gaussians, cameras: Cameras) -> Iterator[Float[Tensor, "3 H W"]]:
    """Cameras of one scene, rendered one by one, on the CPU."""
    for view in range(cameras.intrinsics.shape[1]):
        yield stylizer.render(gaussians, cameras.select([view]).to(stylizer.device)).color[0, 0].cpu()


def serve(arguments: argparse.Namespace, words: list[str]) -> None:
    """Serve the page until it is interrupted."""
    from anystyle.viewer.door import LOOPBACK, new_token

    if find_spec("viser") is None:
        raise ImportError('anystyle view needs viser; pip install "anystyle[viewer]"')
    from anystyle.viewer.serving import Viewer

    scene, render = opened(arguments.input, words)
    token = None if arguments.host in LOOPBACK else new_token()
    with Viewer(
        scene,
        render,
        folder=arguments.keep,
        command=(str(arguments.input), words),
        host=arguments.host,
        port=arguments.port,
        token=token,
    ) as viewer:
        if token is not None:
            print(
                f"warning: whoever reaches {arguments.host} and knows the token sees the scene and can have it painted",
                file=sys.stderr,
            )
        print(f"{viewer.door.url} shows {arguments.input}; Ctrl-C ends it", flush=True)
        while True:
            time.sleep(3600)


if __name__ == "__main__":
    run(lambda: view(*split(parser(), words_of(None))))
