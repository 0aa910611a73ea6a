"""Sizes of exported files and what quantisation loses, as a table in Markdown.

``PYTHONPATH=tests python tests/benchmarks/format_quality.py``

A scene of the procedural world is stylized, exported in every format, and read back: by this project, and by others,
which are gsply for PLY and SPZ, pygltflib for GLB, OpenUSD for USD, the formats' own descriptions for ``.splat`` and
SOG, Chromium for the page, and gaussforge and PlayCanvas's splat-transform where they are installed. The other way
round, this project reads what gaussforge and splat-transform make of the PLY file. PSNR is of renders of the input
views from what was read, against renders of the PLY as this project reads it; the page's is of Chromium's pictures.
"""

import argparse
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

import anystyle
from anystyle.contracts import Format, SceneSource
from anystyle.geometry.transforms import Similarity
from anystyle.methods.branch import Branch
from anystyle.pipeline.encode import EncodedCapture
from anystyle.pipeline.export import export, export_styles
from anystyle.pipeline.options import PoseOptions, SplatOptions, ViewOptions
from anystyle.pipeline.restyle import Restyler
from anystyle.pipeline.saved import read_saved
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import embed_styles
from anystyle.pipeline.stylize import encode_inputs
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians, StyledScene
from chromium import SOFTWARE_GL, browser, find_chromium

sys.path.append(str(Path(__file__).parents[2] / "plugins/formats/tests"))
from export_readers import (  # pyright: ignore[reportMissingImports]
    READERS,
    SPLAT_TRANSFORM,
    from_axes,
    read_with_gaussforge,
    read_with_splat_transform,
    with_gaussforge,
    with_splat_transform,
)

FORGED = ("spz", "splat", "sog") if find_spec("gaussforge") is not None else ()
OTHERS = [
    (FORGED, read_with_gaussforge),
    (("ply", "spz", "splat", "sog") if SPLAT_TRANSFORM else (), read_with_splat_transform),
]
WRITERS = [(FORGED, with_gaussforge), (("spz", "sog", "glb") if SPLAT_TRANSFORM else (), with_splat_transform)]
HALF_A_TURN = Similarity(torch.tensor(1.0), torch.diag(torch.tensor([-1.0, 1.0, -1.0])), torch.zeros(3))
TEXTS = ("thick oil paint in orange and navy", "charcoal drawing", "red dots")


def stylized(scene: int, size: int, num_views: int) -> tuple[EncodedCapture, list[tuple[str, Gaussians]]]:
    """A scene of the procedural world that no bundled network saw, unstyled and in styles."""
    stylizer = anystyle.load()
    views = build(
        SceneSource, {"_target_": catalog().find("scenes", "procedural").path, "split": "heldout", "size": size}
    ).read(scene, range(num_views))
    encoded = encode_inputs(views, stylizer, ViewOptions(), PoseOptions(), SplatOptions(), None, Stages())
    restyler = Restyler(encoded, Branch())
    styles = [(text, restyler(embed_styles([text], stylizer)[0])) for text in reversed(TEXTS)]
    return encoded, [("unstyled", restyler.unstyled), *styles]


@torch.no_grad()
def renders(gaussians: Gaussians, cameras: Cameras) -> Tensor:
    """Of all cameras, sRGB: V 3 H W."""
    views = range(cameras.intrinsics.shape[1])
    return torch.cat([TorchRenderer()(gaussians, cameras.select([view])).color[0] for view in views])


def psnr(images: Tensor, target: Tensor) -> str:
    error = float((images - target).square().mean())
    return "identical" if error < 1e-10 else f"{-10 * np.log10(error):.1f}"


def page_pictures(path: Path, cameras: Cameras, folder: Path) -> Tensor | None:
    """Chromium's pictures of the page from all cameras; ``None`` where there is no Chromium."""
    program, (height, width), pictures = find_chromium(), cameras.size, []
    if program is None:
        return None
    with browser(program, folder, SOFTWARE_GL) as page:
        page.size(width, height)
        page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "light"}])
        page.call("Page.navigate", url=path.as_uri())
        page.wait("document.body && document.body.dataset.ready")
        page.value("document.body.classList.add('bare')")
        for view in range(cameras.intrinsics.shape[1]):
            page.value(f"anystyle.go({view})")
            page.picture(folder / "picture.png")
            pictures.append(np.asarray(Image.open(folder / "picture.png").convert("RGB")) / 255)
    return torch.from_numpy(np.stack(pictures)).float().movedim(-1, 1)


def main() -> None:
    words = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    words.add_argument("--scene", type=int, default=11, help="of the procedural world's held-out scenes")
    words.add_argument("--size", type=int, default=112, help="of its views, in pixels")
    words.add_argument("--views", type=int, default=6)
    given = words.parse_args()
    torch.set_num_threads(1)
    encoded, styles = stylized(given.scene, given.size, given.views)
    cameras, gaussians = encoded.cameras, styles[-1][1]
    write = sys.stdout.write
    write(f"{int((gaussians.opacities > 0).sum()):,} Gaussians, {given.views} views of {cameras.size}, {TEXTS[0]!r}\n")
    write("| Format | Axes | MB | read here | by others | gaussforge | splat-transform | their files read here |\n")
    write("|---|---|---|---|---|---|---|---|\n")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        ply = folder / "scene.ply"
        export(gaussians, ply, "ply")
        target = renders(Gaussians.load(ply), cameras)

        def loss(found: Gaussians) -> str:
            return psnr(renders(found, cameras), target)

        for name, read in READERS.items():
            path, up = folder / f"scene.{name}", build(Format, name).up
            export(gaussians, path, name)
            here, others = loss(read_saved(path).styles[-1][1]), loss(from_axes(up, read(path)))
            read_by = [reader(path, folder) if name in known else None for known, reader in OTHERS]
            columns = ["—" if found is None else loss(found) for found in read_by]
            theirs = []
            for number, (known, writer) in enumerate(WRITERS):
                if name in known:
                    writer(ply, folder / f"theirs{number}.{name}")
                    # They turn no axes, but for GLB; its half a turn about the vertical is taken back.
                    found = read_saved(folder / f"theirs{number}.{name}", "opencv" if name != "glb" else None)
                    theirs.append(
                        loss(HALF_A_TURN.gaussians(found.styles[-1][1]) if name == "glb" else found.styles[-1][1])
                    )
            columns += [", ".join(theirs) or "—"]
            write(
                f"| `{name}` | {up} | {path.stat().st_size / 1e6:.2f} | {here} | {others} | {' | '.join(columns)} |\n"
            )
            sys.stdout.flush()
        path = folder / "scene.html"
        export_styles(StyledScene(tuple(styles), cameras, tuple(encoded.names)), path, "html")
        pictures = page_pictures(path, cameras, folder)
        shown = "—" if pictures is None else psnr(pictures, target)
        write(
            f"| `html`, {len(styles)} styles | opencv | {path.stat().st_size / 1e6:.2f} | — | {shown} | — | — | — |\n"
        )


if __name__ == "__main__":
    main()
