"""Reconstructions of captures, judged on photographs that they never saw."""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, isnan, pi, sin
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.data.folder import read_views
from anystyle.documents import as_number, read_json
from anystyle.evaluation.contract import SCENE, Evaluation, Progress, Protocol, Row
from anystyle.inference import known_cameras
from anystyle.inference.found_cameras import FoundCameras, find_cameras, read_photographs
from anystyle.inference.options import ViewOptions
from anystyle.inference.styles import slug
from anystyle.io.atomic import atomic_directory, write_json
from anystyle.io.sheet import to_pil
from anystyle.perception import lpips
from anystyle.perception.lpips import Lpips
from anystyle.perception.sources import Weights, stand_ins
from anystyle.reconstructions.fit import Fit, scene_of_fit
from anystyle.reconstructions.order import held_out
from anystyle.reconstructions.photographs import fit_photographs
from anystyle.reconstructions.photometric import match_colors, psnr, ssim
from anystyle.stylizer import Stylizer
from anystyle.types import Scene, Views

BETTER = {"psnr": "higher", "matched_psnr": "higher", "ssim": "higher", "lpips": "lower"}
KINDS = ("fit", "feedforward")


@dataclass(frozen=True)
class _Shown:
    """Held-out views as a reconstruction shows them, and what it took to get there."""

    renders: Float[Tensor, "V 3 H W"]
    scene: Scene
    num_gaussians: int


class Captures(Protocol):
    """PSNR, SSIM and LPIPS of views held out of each capture, of the backbone's scene and of a fitted one.

    Cameras are found with all photographs, those held out too; their pixels neither reconstruction sees. The backbone
    gets its own resolution and predicts cameras of its own, among which held-out views are placed by a similarity; the
    fit has the exposure of the views beside. ``matched_psnr`` is PSNR after an affine change of each view's colours.
    Seconds and memory are in the provenance, under ``costs``: cameras, each reconstruction, and restyling its scene
    once; memory is the process's largest so far.

    Args:
        stylizer: Its backbone predicts, its renderer shows, and its branch restyles.
        captures: Folders of photographs, or videos.
        poses: ``sfm`` finds cameras; ``known`` takes those stored beside the photographs.
        quality: Of the fit; see :class:`~anystyle.reconstructions.fit.Fit`.
        num_gaussians: Instead of the quality's.
        num_steps: Instead of the quality's.
        short_side: Of the views in pixels, instead of the quality's.
        holdout: Every so many-th view is held out.
        take: Of more photographs, so many are taken, evenly spaced.
        lpips_backbone: The network of LPIPS.
        weights: Of LPIPS: ``auto`` takes a stand-in where the published ones are missing, and says so.

    Raises:
        ValueError: There is no capture.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        captures: Sequence[str],
        poses: Literal["sfm", "known"] = "sfm",
        quality: str = "good",
        num_gaussians: int | None = None,
        num_steps: int | None = None,
        short_side: int | None = None,
        holdout: int = 8,
        take: int = 48,
        lpips_backbone: Literal["alex", "vgg"] = "alex",
        weights: Weights = "auto",
    ) -> None:
        if not captures:
            raise ValueError("protocol.captures is empty; name folders of photographs or videos")
        self.stylizer, self.captures, self.poses = stylizer, [Path(path).expanduser() for path in captures], poses
        self.fit = Fit(quality=quality, num_gaussians=num_gaussians, num_steps=num_steps, holdout=holdout)
        self.views = ViewOptions(short_side=short_side, take=take)
        self.lpips = lpips.load(lpips_backbone, weights)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        write_wall(folder / "wall")
        small = {"num_gaussians": 100, "num_steps": 4, "short_side": 48, "holdout": 4}
        return {"captures": [str(folder / "wall")], "poses": "known", "weights": "stand_in", **small}

    def run(self, out: Path, progress: Progress) -> Evaluation:
        """Judge each capture; one that is finished is read."""
        records: dict[str, dict[str, Any]] = {}
        for done, path in enumerate(self.captures):
            name = path.parent.name if path.name == "images" else path.stem
            progress("captures", done, len(self.captures))
            folder = out / "captures" / slug(name, 80)
            if not (folder / "record.json").is_file():
                with atomic_directory(folder) as temporary:
                    write_json(temporary / "record.json", self._judge(path, temporary))
            what = f"record of a capture; delete {folder}"
            stored: dict[str, Any] = read_json(folder / "record.json", dict[str, Any], what=what)
            stored["figures"] = {
                kind: {figure: as_number(value) for figure, value in row.items()}
                for kind, row in stored["figures"].items()
            }
            records[name] = stored
        progress("captures", len(self.captures), len(self.captures))
        return self._evaluation(records, out)

    def _evaluation(self, records: Mapping[str, Mapping[str, Any]], out: Path) -> Evaluation:
        rows: list[Row] = []
        for name, record in records.items():
            folder = out / "captures" / slug(name, 80)
            for kind in KINDS:
                files = {"photograph": folder / "photograph_0.png", "result": folder / f"{kind}_0.png"}
                pictures = {what: file for what, file in files.items() if file.is_file()}
                rows.append(Row(name, kind, record["figures"][kind], pictures))
        groups = {kind: _mean([row.figures for row in rows if row.style == kind]) for kind in KINDS}
        groups |= {
            f"{SCENE}{name}": {
                f"{kind}_{figure}": value for kind in KINDS for figure, value in record["figures"][kind].items()
            }
            for name, record in records.items()
        }
        return Evaluation(
            figures=groups["fit"],
            n=sum(int(record["heldout"]) for record in records.values()),
            better=BETTER,
            groups=groups,
            rows=tuple(rows),
            stand_ins=stand_ins(["lpips"], self.lpips.source),
            provenance={
                "scenes": list(records),
                "lpips_network": self.lpips.source.stand_in or self.lpips.source.network,
                "costs": {name: record["costs"] for name, record in records.items()},
                "cameras": {name: record["cameras"] for name, record in records.items()},
            },
        )

    def _judge(self, path: Path, folder: Path) -> dict[str, Any]:
        start = time.process_time()
        views, points, cameras = self._posed(path)
        costs: dict[str, Any] = {"cameras": {"cpu_seconds": round(time.process_time() - start, 1)}}
        chosen = held_out(views.images.shape[1], self.fit.holdout, views.names)
        if not chosen:
            raise ValueError(
                f"{path} has {views.images.shape[1]} photographs with cameras, and every {self.fit.holdout}th is to be "
                "held out; lower protocol.holdout or give more photographs"
            )
        photographs = views.images[0, list(chosen)]
        figures: dict[str, Mapping[str, float]] = {}
        for kind, show in (("fit", self._fit), ("feedforward", self._feedforward)):
            start = time.process_time()
            try:
                shown = show(views, points, chosen)
            except ValueError as error:
                # A scene that cannot be had, such as predicted cameras that run the other way, is a result too.
                figures[kind], costs[kind] = dict.fromkeys(BETTER, float("nan")), {"failed": str(error)}
                continue
            seconds = time.process_time() - start
            figures[kind] = quality(shown.renders, photographs, self.lpips)
            costs[kind] = {"cpu_seconds": round(seconds, 1), "num_gaussians": shown.num_gaussians}
            costs[kind] |= {"restyle_cpu_seconds": round(self._restyle_seconds(shown.scene), 1), "peak_mb": peak_mb()}
            for index, render in enumerate(shown.renders):
                to_pil(render).save(folder / f"{kind}_{index}.png")
        for index, photograph in enumerate(photographs):
            to_pil(photograph).save(folder / f"photograph_{index}.png")
        count = views.images.shape[1]
        return {"figures": figures, "costs": costs, "cameras": cameras, "views": count, "heldout": len(chosen)}

    def _posed(self, path: Path) -> tuple[Views, Sequence[Tensor] | None, dict[str, Any]]:
        multiple = self.stylizer.backbone.patch_size
        enlarge = self.views.short_side is not None
        short_side = self.views.short_side or self.fit.short_side or self.stylizer.backbone.resolution
        if self.poses == "known":
            views, sources = read_views(
                [path], short_side=short_side, multiple=multiple, max_views=self.views.take, enlarge=enlarge
            )
            cameras = known_cameras.from_files(sources).of_all([source.name for source in sources])
            return replace(views, cameras=cameras), None, {"trust": "known"}
        originals = read_photographs([path], self.views)
        posed = find_cameras(
            originals,
            short_side=short_side,
            enlarge=enlarge,
            multiple=multiple,
            progress=lambda line: None,
            keep=False,
        )
        if not isinstance(posed, FoundCameras):
            raise ValueError(f"no cameras are found of {path}: {'; '.join(posed.reasons)}")
        registered = f"{len(posed.sources)} of {len(originals)}"
        return posed.views, posed.points, posed.verdict.report() | {"registered": registered}

    @torch.no_grad()
    def _feedforward(self, views: Views, points: Sequence[Tensor] | None, chosen: tuple[int, ...]) -> _Shown:
        """What the backbone predicts from the other views."""
        assert views.cameras is not None
        seen = [view for view in range(views.images.shape[1]) if view not in chosen]
        images = resized_to(views.images[0, seen], self.stylizer.backbone.resolution, self.stylizer.backbone.patch_size)
        scene = self.stylizer.encode(Views(images[None]).to(self.stylizer.device))
        known = views.cameras.to(self.stylizer.device)
        similarity = known_cameras.scene_from_known(
            known.world_from_camera[0, seen], scene.cameras.world_from_camera[0]
        )
        placed = replace(known, world_from_camera=similarity.poses(known.world_from_camera)).select(list(chosen))
        gaussians = self.stylizer.unstyled(scene)
        renders = [self.stylizer.render(gaussians, placed.select([view])).color[0] for view in range(len(chosen))]
        return _Shown(torch.cat(renders).cpu(), scene, int((gaussians.opacities > 0).sum()))

    def _fit(self, views: Views, points: Sequence[Tensor] | None, chosen: tuple[int, ...]) -> _Shown:
        """Gaussians fitted to the other views; no step sees those held out."""
        assert views.cameras is not None
        views = views.to(self.stylizer.device)
        assert views.cameras is not None
        result = fit_photographs(
            views.images[0],
            views.cameras,
            self.stylizer.renderer,
            num_gaussians=self.fit.num_gaussians,
            options=replace(self.fit.options, final_steps=0),
            points=points,
            heldout=chosen,
        )
        with torch.no_grad():
            cameras = views.cameras
            shown = [self.stylizer.render(result.gaussians, cameras.select([view])).color[0] for view in chosen]
            index = list(chosen)
            exposed = torch.cat(shown) * result.gains[index, :, None, None] + result.biases[index, :, None, None]
            encode = self.stylizer.encode if self.stylizer.branch.gaussian_head else self.stylizer.encode_colors
            scene = scene_of_fit(views, encode(views), result, self.stylizer.renderer)
        return _Shown(exposed.clamp(0, 1).cpu(), scene, result.gaussians.means.shape[1])

    def _restyle_seconds(self, scene: Scene) -> float:
        picture = torch.linspace(0, 1, 64).expand(1, 3, 64, 64) * torch.tensor([1.0, 0.6, 0.2]).view(1, 3, 1, 1)
        embedding = self.stylizer.embed(image=picture.to(self.stylizer.device))
        start = time.process_time()
        with torch.no_grad():
            self.stylizer.restyle(scene, embedding)
        return time.process_time() - start


def resized_to(images: Float[Tensor, "V 3 H W"], short_side: int, multiple: int) -> Float[Tensor, "V 3 h w"]:
    """Images with a shorter side that a network was made for, and sides that are multiples of its patches."""
    scale = short_side / min(images.shape[-2:])
    size = [max(multiple, round(side * scale / multiple) * multiple) for side in images.shape[-2:]]
    return interpolate(images, size=size, mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)


@torch.no_grad()
def quality(
    renders: Float[Tensor, "M 3 H W"], photographs: Float[Tensor, "M 3 H W"], network: Lpips
) -> dict[str, float]:
    """Means over pairs, in single precision: PSNR in dB, before and after colours are matched, SSIM and LPIPS."""
    matched = torch.stack([match_colors(*pair) for pair in zip(renders, photographs, strict=True)])
    return {
        "psnr": float(psnr(renders, photographs).mean()),
        "matched_psnr": float(psnr(matched, photographs).mean()),
        "ssim": float(ssim(renders, photographs).mean()),
        "lpips": float(network.compare(network.describe(renders), network.describe(photographs)).mean()),
    }


def peak_mb() -> int | None:
    """The largest memory that this process held so far, in MB, where the system counts it."""
    try:
        import resource
    except ImportError:  # on Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak // (1024 * 1024 if sys.platform == "darwin" else 1024)


def write_wall(folder: Path, num_views: int = 6, size: int = 64) -> None:
    """Photographs of a coloured wall with cameras in ``transforms.json``: the smallest capture."""
    (folder / "images").mkdir(parents=True)
    texture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (24, 24, 3), dtype=np.uint8))
    wide = np.asarray(texture.resize((8 * size, 8 * size), Image.Resampling.BICUBIC))
    frames = []
    for view in range(num_views):
        turn = pi / 60 * (view - (num_views - 1) / 2)
        y, x = np.mgrid[0:size, 0:size] + 0.5
        across, down = (x - size / 2) / size, (y - size / 2) / size
        # The camera stands 2 in front of the wall's middle, moved along it, and is turned back towards it.
        forward = cos(turn) - across * sin(turn)
        wall_x = -2 * sin(turn) + 2 * cos(turn) * (sin(turn) + across * cos(turn)) / forward
        wall_y = 2 * cos(turn) * down / forward
        column, row = ((4 + 2 * side) * size for side in (wall_x, wall_y))
        pixels = wide[row.astype(int).clip(0, 8 * size - 1), column.astype(int).clip(0, 8 * size - 1)]
        Image.fromarray(pixels).save(folder / "images" / f"{view:02d}.png")
        pose = np.eye(4)
        pose[:3, :3] = [[cos(turn), 0, sin(turn)], [0, 1, 0], [-sin(turn), 0, cos(turn)]]
        pose[:3, 3] = [-2 * sin(turn), 0, -2 * cos(turn)]
        # The file has OpenGL's axes.
        frames.append(
            {"file_path": f"images/{view:02d}.png", "transform_matrix": (pose @ np.diag([1, -1, -1, 1])).tolist()}
        )
    write_json(
        folder / "transforms.json",
        {"fl_x": size, "fl_y": size, "cx": size / 2, "cy": size / 2, "w": size, "h": size, "frames": frames},
    )


def _mean(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Over captures that gave figures; ``nan`` where none did."""
    known = [row for row in figures if not isnan(row["psnr"])]
    return {name: sum(row[name] for row in known) / len(known) if known else float("nan") for name in BETTER}
