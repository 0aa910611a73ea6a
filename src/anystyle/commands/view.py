"""A scene in the browser, restyled while one looks; or as one HTML file that needs no network."""

import argparse
import contextlib
import io
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.commands._compose import compose
from anystyle.commands._flags import split
from anystyle.commands._options import Stylize, checked
from anystyle.commands._run import run, words_of
from anystyle.inference.assemble import assemble_frozen, default_device, default_poses, make_method
from anystyle.inference.encoding import encode_capture
from anystyle.inference.options import PoseOptions
from anystyle.inference.page import write_page
from anystyle.inference.saved import read_saved
from anystyle.inference.stages import Stages
from anystyle.io.video import SUFFIXES
from anystyle.reconstructions.contract import Reconstruction
from anystyle.registry.build import build
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians
from anystyle.viewer.scenes import OpenScene, of_capture, of_saved

Render = Callable[[Gaussians, Cameras], Iterator[Float[Tensor, "3 H W"]]]


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle view``; words such as model=... are Hydra's, as those of ``anystyle stylize``."""
    flags = argparse.ArgumentParser(
        prog="anystyle view",
        description="Look at a scene, and give it styles: photographs, a folder of anystyle stylize, or a PLY file.",
        allow_abbrev=False,
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
        title = saved.styles[-1][0]
        write_page(arguments.html, saved.styles, saved.cameras, title=title, notes="\n".join(saved.notes))
        size = arguments.html.stat().st_size / 1e6
        print(f"{arguments.html}: {len(saved.styles)} styles, {size:.2f} MB; open it in any browser")
        return
    serve(arguments, words)


def opened(path: Path, words: list[str]) -> tuple[OpenScene, Render]:
    """What is to be looked at, and what renders it."""
    config: DictConfig = compose("stylize", words)
    stages = Stages(lambda name, note: print(f"{name} {note} …", file=sys.stderr, flush=True))
    saved = None if _is_photographs(path) else read_saved(path)
    with stages("load", "the model"):
        stylizer = assemble_frozen(config)[0].to(default_device())
    method = make_method(config, stylizer.style_encoder)
    if saved is not None:
        return of_saved(saved, stylizer, method), partial(rendered, stylizer)
    reconstruction = config.get("reconstruction")
    encoded = encode_capture(
        path,
        stylizer,
        checked(config, Stylize).views,
        PoseOptions(config.poses or default_poses(config), config.poses_from),
        refined=config.refine,
        stages=stages,
        reconstruction=None if reconstruction is None else build(Reconstruction, reconstruction),
    )
    return of_capture(encoded, method), partial(rendered, stylizer)


def _is_photographs(path: Path) -> bool:
    if path.is_dir():
        return not any(path.glob("scene.safetensors")) and not any(path.glob("*/scene.safetensors"))
    return path.suffix.lower() in SUFFIXES


@torch.no_grad()
def rendered(stylizer: Stylizer, gaussians: Gaussians, cameras: Cameras) -> Iterator[Float[Tensor, "3 H W"]]:
    """Cameras of one scene, rendered one by one, on the CPU."""
    for view in range(cameras.intrinsics.shape[1]):
        yield stylizer.render(gaussians, cameras.select([view]).to(stylizer.device)).color[0, 0].cpu()


def serve(arguments: argparse.Namespace, words: list[str]) -> None:
    """Serve the page until it is interrupted."""
    from anystyle.viewer.door import LOOPBACK, Door, new_token

    try:
        import viser
    except ImportError:
        raise ImportError('anystyle view needs viser; pip install "anystyle[viewer]"') from None
    from anystyle.viewer.flight import Flight
    from anystyle.viewer.panel import Panel
    from anystyle.viewer.session import Session

    scene, render = opened(arguments.input, words)
    session = Session(
        scene.unstyled, saved=scene.saved, controlled=scene.controlled, file=arguments.keep / "session.json"
    )
    with contextlib.redirect_stdout(io.StringIO()):  # it tells its own address, which is not the door's
        server = viser.ViserServer("127.0.0.1", 0, label="anystyle", verbose=False)
    flight = Flight(scene.cameras, scene.unstyled, render)
    Panel(server, scene, session, inputs=str(arguments.input), uploads=arguments.keep, flight=flight)
    token = None if arguments.host in LOOPBACK else new_token()
    door = Door(target=server.get_port(), host=arguments.host, port=arguments.port, token=token)
    if token is not None:
        print(
            f"warning: whoever reaches {arguments.host} and knows the token sees the scene and can have it painted",
            file=sys.stderr,
        )
    print(f"{door.url} shows {arguments.input}; Ctrl-C ends it", flush=True)
    try:
        while True:
            time.sleep(3600)
    finally:
        door.close()
        session.close()
        server.stop()


if __name__ == "__main__":
    run(lambda: view(*split(parser(), words_of(None))))
