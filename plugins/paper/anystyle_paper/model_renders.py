"""The published protocol: a model's renders of scenes in styles, written as image files, and these judged."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from anystyle.contracts import Method, Metric, SceneSource, StyleSource
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.contracts.scene import required
from anystyle.errors import UserError
from anystyle.evaluation.comparisons import read, read_seconds, seconds_file, write_cameras
from anystyle.evaluation.judge import judge_pairing
from anystyle.evaluation.pairing import CAMERAS, pair
from anystyle.io.atomic import atomic_path
from anystyle.methods.branch import Branch
from anystyle.paths import distinct
from anystyle.ranges import AtLeastOne
from anystyle.stylizer import Stylizer
from anystyle.types import OnProgress, Progress, Scene, Style, Views
from anystyle.vision import preprocess

Variant = Literal["reference", "corrected"]


class ModelRenders(Protocol):
    """Stylize every scene in every style, keep the first frames as images, and judge these (Sec. 4 of the paper).

    Args:
        styles: Every style has an image, which the scores compare with.
        guide: Whether a style enters as its image or as its text.
        variant: ``reference`` writes JPEG of quality 75 with truncated values and shows the model all views of a
            scene, as the published scripts do; ``corrected`` writes PNG with rounded values and shows it the frames
            that are judged.
        scene_names: Which scenes, in this order; all if empty.
        num_scenes: How many scenes at most; ``None`` takes all.
        num_styles: How many styles at most; ``None`` takes all.
        frames: How many frames of each scene are judged, from its first.
        square: Whether the middle square of each view is taken.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        metrics: Mapping[str, Metric],
        scenes: SceneSource | None,
        styles: StyleSource | None,
        method: Method | None = None,
        guide: Literal["image", "text"] = "image",
        variant: Variant = "reference",
        scene_names: Sequence[str] = (),
        num_scenes: AtLeastOne | None = None,
        num_styles: AtLeastOne | None = 50,
        frames: AtLeastOne = 16,
        square: bool = True,
    ) -> None:
        self.stylizer, self.metrics, self.method = stylizer, metrics, method or Branch()
        self.scenes, self.styles = required(scenes, "scenes"), required(styles, "styles")
        self.guide, self.frames, self.square, self.suffix = guide, frames, square, suffix_of(variant)
        self.variant: Variant = variant
        known = _indices(self.scenes, scene_names)
        # Scenes and styles: index by file name.
        files = dict(zip(known, distinct([name.replace("/", "-") for name in known]), strict=True))
        self.planned_scenes = {files[name]: known[name] for name in list(scene_names or known)[:num_scenes]}
        count = min(len(self.styles), num_styles or len(self.styles))
        self.planned_styles = {f"{index:0{max(2, len(str(count - 1)))}d}": index for index in range(count)}

    @classmethod
    def check(cls, **given: Any) -> None:
        _indices(required(given["scenes"], "scenes"), given["scene_names"])
        required(given["styles"], "styles")

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        images = out / "images"
        self._render(images, on_progress)
        folders = (images / name for name in ("content", "style", "stylized", "depth"))
        # The folder may hold a larger evaluation.
        pairing = pair(*folders, layout="{scene}/{style}_{frame}", missing="allow")
        pairing = pairing.chosen(self.planned_scenes, self.planned_styles)
        pairing.require()
        evaluation = judge_pairing(self.metrics, pairing, on_progress)
        scenes = [images / "stylized" / scene for scene in self.planned_scenes]
        seconds = np.array([[read_seconds(seconds_file(at, style)) for style in self.planned_styles] for at in scenes])
        num_inputs = np.array([self._num_inputs(index) for index in self.planned_scenes.values()])
        return replace(evaluation, times={"time_s": float((seconds / num_inputs[:, None]).mean())}).with_facts(
            variant=self.variant,
            guide=self.guide,
            num_scenes=len(self.planned_scenes),
            num_styles=len(self.planned_styles),
            frames=self.frames,
            seconds_a_style=float(seconds.mean()),
            time_s="wall seconds of one pass (reconstruction, style embedding, stylization, rendering of the judged "
            "frames) over the number of input images",
        )

    def _render(self, images: Path, on_progress: OnProgress) -> None:
        total, done = len(self.planned_scenes) * len(self.planned_styles), 0
        for name, index in self.planned_styles.items():
            path = images / "style" / f"{name}{self.suffix}"
            image = self._style(index)[0][0]
            if path.is_file():
                refuse_other(path, image, self.variant, f"style {name}")
            else:
                write_picture(path, image, self.variant)
        for scene_name, number in self.planned_scenes.items():
            on_progress(Progress.count("render", done, total))
            folder = images / "stylized" / scene_name
            frames = [f"{index:03d}" for index in range(min(self._num_inputs(number), self.frames))]
            photographs = [images / "content" / scene_name / f"{frame}{self.suffix}" for frame in frames]
            depth = [images / "depth" / scene_name / name for name in (*(f"{frame}.npy" for frame in frames), CAMERAS)]
            whole = all(path.is_file() for path in (*photographs, *depth))
            if whole:
                for path, image in zip(photographs, self._inputs(number, len(frames)).images[0], strict=True):
                    refuse_other(path, image, self.variant, f"photograph {path.stem} of {scene_name}")
            missing: list[str] = []
            for name in self.planned_styles:
                files = seconds_file(folder, name), *(folder / f"{name}_{frame}{self.suffix}" for frame in frames)
                if not whole or not all(file.is_file() for file in files):
                    missing.append(name)
            done += len(self.planned_styles) - len(missing)
            if not missing:
                continue
            scene, encoding = self._encode(number)
            self._write_content(images, scene_name, scene, frames)
            for name in missing:
                seconds = encoding + self._stylize(scene, frames, folder, name)
                seconds_file(folder, name).write_text(json.dumps({"seconds": seconds}), encoding="utf-8")
                done += 1
                on_progress(Progress.count("render", done, total))

    @torch.no_grad()
    def _encode(self, number: int) -> tuple[Scene, float]:
        """A scene as the model encodes it, and the seconds that took."""
        views = self._inputs(number, self._num_inputs(number))
        patch, (height, width) = self.stylizer.backbone.patch_size, views.size
        if height % patch or width % patch:
            given = f"the views of {self.scenes.name(number)} are {width}x{height} pixels"
            raise UserError(f"{given}; this model needs sides that are multiples of {patch} (an option of the scenes)")
        views = Views(images=views.images.to(self.stylizer.device), names=views.names)
        start = time.perf_counter()
        scene = self.stylizer.encode(views)
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        return scene, time.perf_counter() - start

    @torch.no_grad()
    def _write_content(self, images: Path, name: str, scene: Scene, frames: list[str]) -> None:
        """Write the photographs of a scene, and the depth and cameras that the model predicts from them."""
        cameras = scene.cameras.select(list(range(len(frames))))
        plain = self.stylizer.unstyled(scene)
        for index, frame in enumerate(frames):
            photograph = scene.views.images[0, index]
            write_picture(images / "content" / name / f"{frame}{self.suffix}", photograph, self.variant)
            renders = self.stylizer.render(plain, cameras.select([index]))
            depth = (renders.depth / renders.alpha.clamp_min(1e-6))[0, 0].cpu().numpy()
            with atomic_path(images / "depth" / name / f"{frame}.npy") as temporary:
                np.save(temporary, depth)
        with atomic_path(images / "depth" / name / CAMERAS) as temporary:
            write_cameras(temporary, frames, cameras)

    @torch.no_grad()
    def _stylize(self, scene: Scene, frames: list[str], folder: Path, name: str) -> float:
        """Write the renders of a scene in a style; return the seconds they took, without those of writing."""
        image, style = self._style(self.planned_styles[name])
        start, model = time.perf_counter(), self.stylizer
        embedding = model.embed(text=style.text) if self.guide == "text" else model.embed(image=image.to(model.device))
        gaussians = self.method(model, scene, style.to(model.device), embedding)
        renders: list[Tensor] = []
        for chunk in torch.arange(len(frames)).split(4):  # so many at once, for memory
            renders.extend(model.render(gaussians, scene.cameras.select(chunk.tolist())).color[0].cpu())
        seconds = time.perf_counter() - start
        for frame, render in zip(frames, renders, strict=True):
            if not bool(render.isfinite().all()):
                raise UserError(f"the model's render of {folder.name} in style {name} holds NaN or infinity")
            write_picture(folder / f"{name}_{frame}{self.suffix}", render, self.variant)
        return seconds

    def _style(self, index: int) -> tuple[Float[Tensor, "1 3 h w"], Style]:
        """A style's image, and the style."""
        style = self.styles.read(index)
        if style.image is None:
            raise UserError(f"style {index} has no image, which the scores compare with; choose other styles")
        if self.guide == "text" and not (style.text and style.text[0].strip()):
            raise UserError(f"style {index} has no text; give captions to all styles, or use protocol.guide=image")
        return style.image, style

    def _inputs(self, number: int, count: int) -> Views:
        """The first views of a scene, as the model sees them: squares have neither cameras nor depth."""
        views = self.scenes.read(number, range(count))
        return Views(images=preprocess.middle_square(views.images), names=views.names) if self.square else views

    def _num_inputs(self, number: int) -> int:
        """How many views of a scene the model sees."""
        count = self.scenes.num_views(number)
        return count if self.variant == "reference" else min(count, self.frames)


def _indices(scenes: SceneSource, chosen: Sequence[str]) -> dict[str, int]:
    """The places of scenes by name; a UserError if a chosen one is not among them."""
    known = {scenes.name(index): index for index in range(len(scenes))}
    if absent := [name for name in chosen if name not in known]:
        there = ", ".join(list(known)[:8])
        raise UserError(f"scene_names: there is no scene {absent[0]!r} in this source, which has {there}")
    return known


def suffix_of(variant: Variant) -> str:
    """The suffix of image files that a variant writes."""
    return ".jpg" if variant == "reference" else ".png"


def write_picture(path: Path, image: Float[Tensor, "3 H W"], variant: Variant) -> None:
    """Write an image of values in [0, 1], others clamped: ``reference`` as JPEG of quality 75, else as PNG."""
    values = image.detach().clamp(0, 1) * 255
    # The published scripts truncate, which darkens by half a step on average.
    values = values if variant == "reference" else values.round()
    picture = Image.fromarray(np.ascontiguousarray(values.byte().permute(1, 2, 0).cpu().numpy()))
    with atomic_path(path) as temporary:
        picture.save(temporary, **({"quality": 75, "subsampling": "4:2:0"} if variant == "reference" else {}))


def refuse_other(path: Path, image: Float[Tensor, "3 H W"], variant: Variant, what: str) -> None:
    """Raise a UserError if a stored picture is another than an image as it would be written now."""
    with TemporaryDirectory() as folder:  # for JPEG takes small patterns away
        write_picture(made := Path(folder) / path.name, image, variant)
        before, now = (adaptive_avg_pool2d(read(each), 16) for each in (path, made))
    if (before - now).abs().mean() > 0.02:  # other releases of JPEG round otherwise
        raise UserError(f"{what} is no longer that of the renders, {path}; give another --out")
