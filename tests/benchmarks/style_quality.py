"""Style quality on real captures: ``python -m tests.benchmarks.style_quality --split test`` prints a table in Markdown.

A row is a way to stylize. With ``--scene single_pass`` nothing is fitted; with ``--scene fit`` Gaussians are fitted to
the captures, whose cameras are found, and their colours are solved back in several ways. Columns:

- found in colour, and in equalised grey: the share of scenes whose painting is the nearest of 35, or with ``--paintings
  unseen`` of the 20 that ``model=tiny_paper`` was not trained on; by chance 0.03, or 0.05. By statistics of
  EfficientNet-Lite0 (``anystyle.vision.statistics``), which trained ``model=tiny_paper`` and ``tiny_paper_taught`` and
  not the painter, and by the 100 numbers of Magenta, whose networks are the painter's and taught ``tiny_paper_taught``.
  With ``--judges tiny`` by ``style_encoder=tiny``, which knows procedural styles alone and trained
  ``model=tiny_paper``;
- edges: the correlation of the gradients of renders with those of the unstyled scene's;
- sharpness: mean absolute difference of neighbouring pixels, as a share of the 2D teacher's;
- PSNR: of renders against the 2D teacher's pictures, in dB;
- warp: masked RMSE between neighbouring views, moved by the depth of the unstyled scene; and by how much it is above
  1.15 of the unstyled scene's plus 0.02;
- seconds: CPU time of one style on an encoded scene, rendering included.

Captures and paintings come in two halves, ``tune`` and ``test``; what is chosen is chosen on the first. Paintings are
drawn with a fixed seed. Blur alone lowers the warping error, and sharpening alone raises sharpness: read the columns
together.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import av
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

import anystyle
from anystyle.contracts import Reconstruction
from anystyle.data.images import read_image, to_tensor
from anystyle.evaluation.run import configured, trained_runs
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.geometry.warp import depth_around, reproject, sample_at
from anystyle.methods.branch import Branch
from anystyle.metrics.style_retrieval import StyleRetrieval
from anystyle.pipeline.load import assemble_frozen
from anystyle.pipeline.options import PoseOptions, SplatOptions, ViewOptions
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.stylize import encode_inputs
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.stylizer import Stylizer
from anystyle.types import Scene, Style, Views
from anystyle.vision.statistics import centered_cosines, equalized_gray
from anystyle_methods.brush import Brush
from tests.support.real_data import ROOT

CAPTURES = {
    "tune": ("videos/llff_horns.mp4", "videos/dtu_scan_106.mp4", "videos/vrnerf_apartment.mp4"),
    "captures": tuple(f"captures/{name}" for name in ("street", "bronze_axe", "brighton_beach", "banana")),
    "test": ("videos/llff_fortress.mp4", "videos/horizongs_hillside_summer.mp4", "scenes/train/images"),
}
NUM_VIEWS, NUM_CHOICES, SMALL = 8, 35, 32
JUDGES = ("EfficientNet", "Magenta")
load = cache(anystyle.load)


@dataclass(frozen=True)
class Case:
    """An encoded capture, its reconstruction and one painting."""

    stylizer: Stylizer
    scene: Scene
    unstyled: Tensor
    painting: Tensor

    @property
    def photographs(self) -> Tensor:
        return self.scene.views.images

    def render(self, colors: Tensor) -> Tensor:
        """The scene with the colours of its pixels (1 V 3 H W) replaced."""
        attributes = replace(self.scene.attributes, color=constant_from_rgb(colors.movedim(2, -1))[..., None])
        gaussians = self.stylizer.backbone.adapter(attributes, self.scene.geometry, self.scene.clusters)
        return self.stylizer.render(gaussians, self.scene.cameras).color


def unstyled(case: Case) -> Tensor:
    return case.unstyled


def palette_transfer(case: Case) -> Tensor:
    """Mean and covariance of the painting's colours by the Monge-Kantorovitch map (Pitié and Kokaram 2007)."""
    pixels, target = (image.movedim(-3, -1).reshape(-1, 3).double() for image in (case.photographs, case.painting))
    covariance = torch.cov(pixels.T) + 1e-5 * torch.eye(3)
    root, inverse = _power(covariance, 0.5), _power(covariance, -0.5)
    matrix = inverse @ _power(root @ torch.cov(target.T) @ root, 0.5) @ inverse
    # Renders are linear in colours: mapped ones of fitted Gaussians are renders of mapped colours.
    moved = pixels if case.scene.gaussians is None else case.unstyled.movedim(2, -1).reshape(-1, 3).double()
    moved = ((moved - pixels.mean(0)) @ matrix + target.mean(0)).float().clamp(0, 1)
    images = moved.view(case.photographs.movedim(2, -1).shape).movedim(-1, 2)
    return case.render(images) if case.scene.gaussians is None else images


def teacher(case: Case) -> Tensor:
    """Photographs stylized one by one: what the style asks for, and no 3D scene."""
    from anystyle_magenta import stylize_images

    injector = case.stylizer.branch.injectors["color"]
    embedding = case.stylizer.embed(image=case.painting)
    images = case.photographs
    for size in injector.sizes(images.shape[-2:]):
        images = stylize_images(injector.network, images, embedding.vector, working_size=size)
    return images


def single_pass(case: Case) -> Tensor:
    gaussians = case.stylizer.restyle(case.scene, case.stylizer.embed(image=case.painting))
    return case.stylizer.render(gaussians, case.scene.cameras).color


def trained(model: str) -> Callable[[Case], Tensor]:
    """Another model's style branch on the same scene, which the same backbone encoded."""

    def method(case: Case) -> Tensor:
        other = load(model)
        gaussians = other.restyle(case.scene, other.embed(image=case.painting))
        return other.render(gaussians, case.scene.cameras).color

    return method


def of_run(folder: Path) -> Callable[[Case], Tensor]:
    """The style branch that a run trained, on the same scene."""
    stylizer, _ = assemble_frozen(configured(compose("evaluate", ["model=tiny_paper_taught"]), folder))

    def method(case: Case) -> Tensor:
        gaussians = stylizer.restyle(case.scene, stylizer.embed(image=case.painting))
        return stylizer.render(gaussians, case.scene.cameras).color

    return method


def brushed(case: Case) -> Tensor:
    """The fitted scene under brush strokes."""
    gaussians = Brush()(case.stylizer, case.scene, Style(case.painting), case.stylizer.embed(image=case.painting))
    return case.stylizer.render(gaussians, case.scene.cameras).color


def solved(steps: int, refined: int = 0) -> Callable[[Case], Tensor]:
    """The fitted scene in colours that are solved back in so many steps, and refined in so many."""

    def method(case: Case) -> Tensor:
        embedding = case.stylizer.embed(image=case.painting)
        gaussians = Branch(fit_colors=steps, refine_strokes=refined)(
            case.stylizer, case.scene, Style(case.painting), embedding
        )
        return case.stylizer.render(gaussians, case.scene.cameras).color

    return method


METHODS: dict[str, dict[str, Callable[[Case], Tensor]]] = {
    "single_pass": {
        "unstyled": unstyled,
        "palette transfer": palette_transfer,
        "2D teacher, view by view": teacher,
        "single pass": single_pass,
        "model=tiny": trained("tiny"),
        "model=tiny_paper": trained("tiny_paper"),
        "model=tiny_paper_taught": trained("tiny_paper_taught"),
    },
    "fit": {
        "unstyled": unstyled,
        "2D teacher, view by view": teacher,
        "palette transfer": palette_transfer,
        "single pass, colours solved": solved(4),
        "the same, refine_strokes=60": solved(4, 60),
        "method=brush": brushed,
    },
}


def fitted(path: Path, stylizer: Stylizer, short_side: int) -> Scene:
    """Gaussians fitted to all photographs of a small capture, or to twice as many views as are encoded elsewhere."""
    small = path.is_dir() and sum(1 for _ in path.iterdir()) <= SMALL
    views = ViewOptions(short_side=short_side, take=None if small else 2 * NUM_VIEWS)
    poses, splat = PoseOptions("sfm"), SplatOptions()
    fit = build(Reconstruction, {"_target_": catalog().find("reconstruction", "fit").path, "holdout": 0})
    capture = encode_inputs(path, stylizer, views, poses, splat, fit, Stages())
    return capture.groups[0].scene


def read_capture(path: Path, short_side: int, multiple: int) -> Views:
    """Consecutive frames from the middle of a clip, cut to multiples of a patch."""
    if path.is_dir():
        frames = [read_image(file) for file in sorted(path.glob("*.png"))]
    else:
        with av.open(str(path)) as container:
            frames = [to_tensor(frame.to_image()) for frame in container.decode(video=0)]
    first = max(0, (len(frames) - NUM_VIEWS) // 2)
    images = torch.stack(frames[first : first + NUM_VIEWS])
    scale = short_side / min(images.shape[-2:])
    sides = [round(side * scale) for side in images.shape[-2:]]
    images = F.interpolate(images, size=sides, mode="bicubic", antialias=True).clamp(0, 1)
    height, width = (side // multiple * multiple for side in sides)
    return Views(images=images[None, :, :, :height, :width].contiguous())


def paintings(split: str, kind: str = "all") -> list[Tensor]:
    """Those of a split, or those that nothing was trained on."""
    if kind == "unseen":
        return [read_image(file)[None] for file in sorted((ROOT / "styles").glob("style_*.jpg"))]
    files = sorted([*(ROOT / "styles").glob("*.jpg"), *(ROOT / "paintings").glob("*.jpg")])
    order = np.random.default_rng(16).permutation(len(files))
    start = 0 if split == "tune" else NUM_CHOICES
    return [read_image(files[index])[None] for index in order[start : start + NUM_CHOICES]]


def judges(names: Sequence[str] = JUDGES) -> list[Callable[[Tensor], Tensor]]:
    """What pictures are told apart by."""
    from anystyle_magenta.retrieval import MagentaRetrieval

    known = {
        "EfficientNet": lambda: StyleRetrieval().describe,
        "Magenta": lambda: MagentaRetrieval().describe,
        "tiny": lambda: anystyle.load("tiny").style_encoder.embed_images,
    }
    return [known[name]() for name in names]


def describe(looks: Sequence[Callable[[Tensor], Tensor]], images: Tensor) -> list[Tensor]:
    """By every judge in colour and in equalised grey, the means over images."""
    return [look(seen).mean(0) for look in looks for seen in (images, equalized_gray(images))]


def edge_correlation(images: Tensor, unstyled: Tensor) -> float:
    pairs = [torch.stack([x.diff(dim=axis).flatten() for x in (images, unstyled)]) for axis in (-1, -2)]
    return float(torch.corrcoef(torch.cat(pairs, dim=1))[0, 1])


def sharpness(images: Tensor) -> float:
    return float(images.diff(dim=-1).abs().mean() + images.diff(dim=-2).abs().mean())


def warping_error(images: Tensor, depth: Tensor, scene: Scene, tolerance: float = 0.02) -> float:
    """RMSE of each view against its neighbours, moved by depth, where they see the same surface."""
    cameras, errors = scene.cameras, []
    num_views = images.shape[1]
    for source in range(num_views):
        for target in {source - 1, source + 1} & set(range(num_views)):
            pose = torch.linalg.solve(cameras.world_from_camera[:, target], cameras.world_from_camera[:, source])
            moved = reproject(depth[:, source], cameras.intrinsics[:, source], cameras.intrinsics[:, target], pose)
            _, farthest = depth_around(depth[:, target], moved.displacement)
            seen = moved.inside & (moved.depth <= farthest * (1 + tolerance)) & (depth[:, source] > 0)
            displacement = torch.where(moved.inside[:, None], moved.displacement, 0)
            error = (sample_at(images[:, target], displacement) - images[:, source]).square().mean(1)
            if int(seen.sum()) > 50:
                errors.append(float(error[seen].mean().sqrt()))
    return float(np.mean(errors))


def _power(matrix: Tensor, exponent: float) -> Tensor:
    values, axes = torch.linalg.eigh(matrix)
    return axes @ torch.diag(values.clamp_min(1e-8) ** exponent) @ axes.T


@dataclass
class Tally:
    """What one method reached: figures of each result, and what each was taken for."""

    figures: list[list[float]] = field(default_factory=list)
    hits: list[Tensor] = field(default_factory=list)

    def row(self, name: str) -> str:
        shares = " | ".join(f"{share:.2f}" for share in torch.cat(self.hits, dim=1).double().mean(1))
        sharp, edges, ratio, error, excess, seconds = np.mean(self.figures, 0)
        return (
            f"| {name} | {shares} | {sharp:.2f} | {edges:.2f} | {ratio:.1f} | {error:.3f} | {excess:+.3f} "
            f"| {seconds:.2f} |"
        )


@torch.no_grad()
def measure(
    stylizer: Stylizer,
    captures: Sequence[str],
    choices: Sequence[Tensor],
    num_styles: int,
    short_side: int,
    kind: str,
    methods: dict[str, Callable[[Case], Tensor]],
    looks: Sequence[Callable[[Tensor], Tensor]],
) -> dict[str, Tally]:
    """Every method on every capture in the first styles."""
    gallery = [torch.stack(vectors) for vectors in zip(*(describe(looks, each) for each in choices), strict=True)]
    tallies = {name: Tally() for name in methods}
    for path in captures:
        if kind == "fit":
            scene = fitted(ROOT / path, stylizer, short_side)
        else:
            scene = stylizer.encode(read_capture(ROOT / path, short_side, stylizer.backbone.patch_size))
        photographs = scene.views.images
        base = stylizer.render(stylizer.unstyled(scene), scene.cameras)
        depth = torch.where(base.alpha > 0.5, base.depth / base.alpha.clamp_min(1e-3), 0)
        limit = 1.15 * warping_error(base.color, depth, scene) + 0.02
        sys.stdout.write(f"{path}: {tuple(photographs.shape)}, PSNR {psnr(base.color, photographs):.1f} dB\n")
        sys.stdout.flush()
        cases = [Case(stylizer, scene, base.color, painting) for painting in choices[:num_styles]]
        targets = [teacher(case) for case in cases]
        for name, method in methods.items():
            described: list[list[Tensor]] = []
            for case, target in zip(cases, targets, strict=True):
                started = time.process_time()
                images = method(case)
                seconds = time.process_time() - started
                error = warping_error(images, depth, scene)
                sharp = sharpness(images) / sharpness(target)
                edges = edge_correlation(images, base.color)
                tallies[name].figures.append([sharp, edges, psnr(images, target), error, error - limit, seconds])
                described.append(describe(looks, images[0, 1::3]))
            sides = zip(zip(*described, strict=True), gallery, strict=True)
            nearest = [centered_cosines(torch.stack(vectors), known).argmax(1) for vectors, known in sides]
            tallies[name].hits.append(torch.stack(nearest) == torch.arange(num_styles))
    return tallies


def psnr(images: Tensor, target: Tensor) -> float:
    return -10 * float((images - target).square().mean().clamp_min(1e-10).log10())


def main() -> None:
    words = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    words.add_argument("--split", choices=CAPTURES, default="tune")
    words.add_argument("--paintings", choices=("all", "unseen"), default="all", help="what is chosen from")
    words.add_argument("--styles", type=int, default=12, help="paintings to stylize in, the first so many")
    words.add_argument("--scene", choices=METHODS, default="single_pass")
    words.add_argument("--methods", nargs="+", help="some of the rows, by name")
    words.add_argument("--runs", type=Path, help="a folder of trained runs, of model=tiny_paper_taught: a row each")
    words.add_argument("--captures", type=int, default=3, help="of the split, the first so many")
    words.add_argument("--short-side", type=int, default=112, help="of the views, in pixels")
    words.add_argument("--judges", nargs="+", choices=(*JUDGES, "tiny"), default=JUDGES)
    words.add_argument("overrides", nargs="*", help="such as injector.working_size=336")
    given = words.parse_args()
    torch.set_num_threads(1)
    captures = CAPTURES[given.split][: given.captures]
    stylizer = anystyle.load("painter", given.overrides)
    choices = paintings(given.split, given.paintings)
    rows = {name: METHODS[given.scene][name] for name in given.methods or METHODS[given.scene]}
    rows |= {folder.name: of_run(folder) for folder in (trained_runs(given.runs) if given.runs else ())}
    tallies = measure(
        stylizer, captures, choices, given.styles, given.short_side, given.scene, rows, judges(given.judges)
    )
    title = f"{given.split}: {len(captures)} captures x {given.styles} paintings of {len(choices)}"
    found = [f"{what} ({judge})" for judge in given.judges for what in ("found in colour", "in grey")]
    columns = (*found, "sharpness", "edges", "PSNR", "warp", "above its limit", "CPU s")
    lines = [f"| {' | '.join((title, *columns))} |", "|---" * (1 + len(columns)) + "|"]
    sys.stdout.write("\n".join([*lines, *(tally.row(name) for name, tally in tallies.items())]) + "\n")


if __name__ == "__main__":
    main()
