"""Beside OpenSplat: PSNR of a held-out view over CPU seconds, for the same cameras, photographs and size.

``PYTHONPATH=plugins/captures:plugins/cpu_renderer OMP_NUM_THREADS=1 python tests/benchmarks/opensplat.py BINARY OUT
photos/ ... --seconds 600`` finds cameras once (counted for neither), writes a COLMAP project with points of our stereo,
runs OpenSplat on it with its defaults until it has used so many CPU seconds, and fits the same views with
``reconstruction=fit``, before its final steps. A view in the middle is held out, which each renders by itself:
OpenSplat every ten steps, at a quarter of the size at first, enlarged here. ``OUT/NAME.json`` has the curves,
``OUT/opensplat.png`` all of them.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import PosedViews, Renderer
from anystyle.data.folder import read_originals
from anystyle.data.images import read_image
from anystyle.errors import UserError
from anystyle.io import colmap
from anystyle.io.sheet import to_pil
from anystyle.types import Views, no_progress
from anystyle_captures.fit import Fit, fit_photographs
from anystyle_captures.initial import from_stereo
from anystyle_captures.photometric import quality_of
from anystyle_captures.stereo import plane_sweep
from anystyle_captures.structure_from_motion import StructureFromMotion
from anystyle_cpu_renderer.renderer import CpuRenderer

NUM_POINTS = 5000
Curve = list[tuple[float, float, float]]
"""CPU seconds, PSNR in dB and SSIM."""


def write_project(folder: Path, views: Views, points: Tensor, colors: Tensor) -> None:
    """All views as a COLMAP project."""
    cameras = views.cameras
    assert cameras is not None
    (folder / "images").mkdir(parents=True, exist_ok=True)
    names = [f"{view:03d}.png" for view in range(views.images.shape[1])]
    for name, image in zip(names, views.images[0], strict=True):
        to_pil(image).save(folder / "images" / name)
    matrices = cameras.intrinsics[0].double().numpy(), cameras.camera_from_world[0].double().numpy()
    sizes = [views.size] * len(names)
    model = colmap.pinhole_model(names, sizes, *matrices, points.double().numpy(), colors.numpy())
    colmap.write(model, folder / "sparse" / "0")


def points_of(posed: PosedViews, training: list[int]) -> tuple[Tensor, Tensor]:
    """Points with colours from stereo of the training views, as many as COLMAP would have of features."""
    images, cameras = posed.views.images[0, training], posed.views.cameras
    assert cameras is not None
    stereo = plane_sweep(images, cameras.select(training), points=[posed.points[view] for view in training])
    found = from_stereo(
        images, cameras.select(training), stereo, num_gaussians=NUM_POINTS, unsupported=0.0,
        generator=torch.Generator().manual_seed(0),
    )  # fmt: skip
    return found.means, (255 * found.colors.clamp(0, 1)).byte()


def cpu_seconds(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run_opensplat(binary: Path, project: Path, view: int, seconds: int) -> dict[Path, float]:
    """Its renders of a view that it does not train on, with the CPU seconds used until then."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))

    out = project / "val"
    words = [binary, project, "--cpu", "-n", "30000", "-o", project / "out.ply"]
    words += ["--val", "--val-image", f"{view:03d}.png", "--val-render", out]
    saved: dict[Path, float] = {}
    with (project / "log.txt").open("w") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log, preexec_fn=limit)
        while process.poll() is None:
            for path in set(out.glob("*.png")) - set(saved):
                saved[path] = cpu_seconds(process.pid)
            time.sleep(0.1)
    return saved


def fit(views: Views, points: tuple[Tensor, ...], view: int, renderer: Renderer) -> Curve:
    """Our curve, ended by SSIM where it is known: at the end."""
    num_gaussians, options = Fit(quality="good").amounts(views.images.shape[1])
    options, curve, started = replace(options, final_steps=0, evaluate_every=50), Curve(), time.process_time()
    assert views.cameras is not None
    result = fit_photographs(
        views.images[0], views.cameras, renderer, num_gaussians=num_gaussians, options=options, points=points,
        heldout=[view],
        on_progress=lambda at: curve.append((time.process_time() - started, at.heldout_psnr or 0.0, float("nan"))),
    )  # fmt: skip
    with torch.no_grad():
        render = renderer(result.gaussians, views.cameras.select([view])).color[0]
    quality = quality_of(render.clamp(0, 1), views.images[0, [view]])
    return [*curve[:-1], (curve[-1][0], quality.psnr, quality.ssim)]


def compare(path: Path, arguments: argparse.Namespace) -> None:
    """Both on one capture."""
    originals = read_originals([path], longest=1600, max_views=48)
    posed = StructureFromMotion()(originals, short_side=384, multiple=14, enlarge=False, on_progress=no_progress)
    if not isinstance(posed, PosedViews):
        raise SystemExit(f"{path}: {posed}")
    views, project, number = posed.views, arguments.out / path.name, posed.views.images.shape[1]
    view = number // 2
    ours = fit(views, posed.points, view, CpuRenderer())
    write_project(project, views, *points_of(posed, [other for other in range(number) if other != view]))
    saved, theirs = run_opensplat(arguments.binary, project, view, arguments.seconds), Curve()
    photograph = views.images[0, [view]]
    for file, at in saved.items():
        with suppress(UserError):  # it was stopped while it wrote
            render = interpolate(read_image(file)[None], views.size, mode="bicubic").clamp(0, 1)
            quality = quality_of(render, photograph)
            theirs.append((at, quality.psnr, quality.ssim))
    record = {
        "size": f"{views.size[1]}x{views.size[0]}",
        "views": number - 1,
        "ours": ours,
        "opensplat": sorted(theirs),
    }
    (arguments.out / f"{path.name}.json").write_text(json.dumps(record, indent=1))


def draw(out: Path) -> None:
    """Every curve that was measured, a panel a capture."""
    records = {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}
    figure, axes = plt.subplots(1, len(records), figsize=(4 * len(records), 3.2), squeeze=False)
    for axis, (name, record) in zip(axes[0], records.items(), strict=True):
        for key, label, style in (("ours", "anystyle, quality=good", "k-"), ("opensplat", "OpenSplat", "k--")):
            curve = np.array(record[key])
            axis.plot(curve[:, 0], curve[:, 1], style, label=label)
        axis.set(xscale="log", xlabel="CPU seconds", title=f"{name}, {record['views']} views of {record['size']}")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("PSNR of the view held out, dB")
    axes[0, 0].legend()
    figure.tight_layout()
    figure.savefig(out / "opensplat.png", dpi=110)


def main() -> None:
    """Compare on each capture, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--seconds", type=int, default=600, help="CPU seconds of OpenSplat a capture")
    arguments = parser.parse_args()
    for path in arguments.captures:
        compare(path, arguments)
        sys.stdout.write(f"{path.name} done\n")
    draw(arguments.out)


if __name__ == "__main__":
    main()
