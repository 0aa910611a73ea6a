"""A model's renders of scenes in styles, as image files that are judged."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Metric, SceneSource, StyleSource
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, required
from anystyle.evaluation.folders import CAMERAS, pair, read_seconds, seconds_file, write_cameras
from anystyle.evaluation.resume import judge_pairing
from anystyle.io.atomic import atomic_path
from anystyle.methods.branch import Branch
from anystyle.methods.contract import Method
from anystyle.stylizer import Stylizer
from anystyle.types import Scene, Style, Views

RENDER_CHUNK = 4
Variant = Literal["reference", "corrected"]


class _Plan(NamedTuple):
    """What is rendered: scenes and styles by number and by file name."""

    scenes: tuple[tuple[int, str], ...]
    styles: tuple[tuple[int, str], ...]


class ModelRenders(Protocol):
    """Stylizes scenes in styles, keeps the first frames as images, and judges these.

    Args:
        styles: Every style has an image, which the figures compare with.
        guide: Whether a style enters as its image or as its text.
        variant: ``reference`` writes JPEG of quality 75 with truncated values and shows the model all views of a
            scene, as the published scripts do; ``corrected`` writes PNG with rounded values and shows it the frames
            that are judged.
        scene_names: Which scenes, in this order; all if empty.
        num_scenes: At most so many; ``None`` takes all.
        num_styles: At most so many; ``None`` takes all.
        frames: Of each scene, the first so many are judged.
        square: Whether the middle square of each view is taken.

    Raises:
        ValueError: A number is below 1, or a source is not configured or lacks a scene that is named.
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
        num_scenes: int | None = None,
        num_styles: int | None = 50,
        frames: int = 16,
        square: bool = True,
    ) -> None:
        for name, value in (("num_scenes", num_scenes), ("num_styles", num_styles), ("frames", frames)):
            if value is not None and value < 1:
                raise ValueError(f"{name}={value}: give at least 1")
        self.stylizer, self.metrics = stylizer, metrics
        self.method = method or Branch()
        self.scenes, self.styles = required(scenes, "scenes"), required(styles, "styles")
        self.guide = guide
        self.variant: Variant = variant
        self.frames = frames
        self.square = square
        self.suffix = suffix_of(variant)
        self.plan = self._plan(scene_names, num_scenes, num_styles)

    def run(self, out: Path, progress: Progress) -> Evaluation:
        """Render what is missing below ``out/images``, and compute the figures of all that was asked for.

        Raises:
            ValueError: A style lacks what it enters as, a view does not fit the model, or a render is not finite.
        """
        images = out / "images"
        self._render(images, progress)
        pairing = pair(images / "content", images / "style", images / "stylized", images / "depth")
        # An evaluation of fewer scenes in the folder of a larger one judges those asked for.
        scenes, styles = ({name for _, name in part} for part in self.plan)
        chosen = tuple(cell for cell in pairing.cells if cell.scene in scenes and cell.style in styles)
        evaluation = judge_pairing(self.metrics, replace(pairing, cells=chosen), out, progress)
        seconds, seconds_an_image = self._seconds(images)
        return replace(evaluation, times={"time_s": seconds_an_image}).with_facts(
            variant=self.variant,
            guide=self.guide,
            num_scenes=len(self.plan.scenes),
            num_styles=len(self.plan.styles),
            frames=self.frames,
            seconds_a_style=seconds,
            time_s="wall seconds of one pass (reconstruction, style embedding, stylization, rendering of the judged "
            "frames) over the number of input images",
        )

    def _plan(self, scene_names: Sequence[str], num_scenes: int | None, num_styles: int | None) -> _Plan:
        known = {self.scenes.name(index): index for index in range(len(self.scenes))}
        absent = [name for name in scene_names if name not in known]
        if absent:
            there = ", ".join(list(known)[:8])
            raise ValueError(f"scene_names: there is no scene {absent[0]!r} in this source, which has {there}")
        chosen = list(scene_names or known)[:num_scenes]
        count = min(len(self.styles), num_styles or len(self.styles))
        width = max(2, len(str(count - 1)))
        return _Plan(
            tuple((known[name], name.replace("/", "-")) for name in chosen),
            tuple((index, f"{index:0{width}d}") for index in range(count)),
        )

    def _render(self, images: Path, progress: Progress) -> None:
        total = len(self.plan.scenes) * len(self.plan.styles)
        done = 0
        for number, style_name in self.plan.styles:
            self._write_style(images / "style" / f"{style_name}{self.suffix}", number)
        for number, scene_name in self.plan.scenes:
            folder = images / "stylized" / scene_name
            missing = [row for row in self.plan.styles if not seconds_file(folder, row[1]).is_file()]
            done += len(self.plan.styles) - len(missing)
            if not missing:
                continue
            progress("render", done, total)
            scene, frames, encoding = self._encode(number)
            self._write_content(images, scene_name, scene, frames)
            for index, style_name in missing:
                seconds = encoding + self._stylize(scene, frames, folder, index, style_name)
                seconds_file(folder, style_name).write_text(json.dumps({"seconds": seconds}), encoding="utf-8")
                done += 1
                progress("render", done, total)

    @torch.no_grad()
    def _encode(self, number: int) -> tuple[Scene, list[str], float]:
        shown = self._num_inputs(number)
        views = self.scenes.read(number, range(shown))
        if self.square:
            views = middle_square(views)
        self._check(views, self.scenes.name(number))
        names = [f"{index:03d}" for index in range(min(shown, self.frames))]
        device = next(self.stylizer.parameters()).device
        start = time.perf_counter()
        scene = self.stylizer.encode(replace(views, cameras=None, depth=None).to(device))
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        return scene, names, time.perf_counter() - start

    def _check(self, views: Views, name: str) -> None:
        patch = self.stylizer.backbone.patch_size
        if any(side % patch for side in views.size):
            raise ValueError(
                f"the views of {name} are {views.size[1]}x{views.size[0]} pixels; this model needs sides that are "
                f"multiples of {patch} (an option of the scenes)"
            )

    @torch.no_grad()
    def _write_content(self, images: Path, name: str, scene: Scene, frames: list[str]) -> None:
        cameras = scene.cameras.select(list(range(len(frames))))
        plain = self.stylizer.unstyled(scene)
        for index, frame in enumerate(frames):
            write_picture(
                images / "content" / name / f"{frame}{self.suffix}", scene.views.images[0, index], self.variant
            )
            renders = self.stylizer.render(plain, cameras.select([index]))
            far = (renders.depth / renders.alpha.clamp_min(1e-6))[0, 0].cpu().numpy()
            with atomic_path(images / "depth" / name / f"{frame}.npy") as temporary:
                np.save(temporary, far)
        with atomic_path(images / "depth" / name / CAMERAS) as temporary:
            write_cameras(temporary, frames, cameras)

    @torch.no_grad()
    def _stylize(self, scene: Scene, frames: list[str], folder: Path, index: int, name: str) -> float:
        style = self._style(index)
        device = next(self.stylizer.parameters()).device
        start = time.perf_counter()
        embedding = (
            self.stylizer.embed(text=style.text)
            if self.guide == "text"
            else self.stylizer.embed(image=None if style.image is None else style.image.to(device))
        )
        gaussians = self.method(self.stylizer, scene, style.to(device), embedding)
        renders: list[Tensor] = []
        for first in range(0, len(frames), RENDER_CHUNK):
            chunk = scene.cameras.select(list(range(first, min(first + RENDER_CHUNK, len(frames)))))
            renders.extend(self.stylizer.render(gaussians, chunk).color[0].cpu())
        seconds = time.perf_counter() - start
        for frame, image in zip(frames, renders, strict=True):
            if not bool(image.isfinite().all()):
                raise ValueError(f"the model's render of {folder.name} in style {name} holds NaN or infinity")
            write_picture(folder / f"{name}_{frame}{self.suffix}", image, self.variant)
        return seconds

    def _style(self, index: int) -> Style:
        style = self.styles.read(index)
        if style.image is None:
            raise ValueError(f"style {index} has no image, which the figures compare with; choose other styles")
        if self.guide == "text" and not (style.text and style.text[0].strip()):
            raise ValueError(f"style {index} has no text; give captions to all styles, or use protocol.guide=image")
        return style

    def _write_style(self, path: Path, index: int) -> None:
        if not path.is_file():
            style = self._style(index)
            assert style.image is not None
            write_picture(path, style.image[0], self.variant)

    def _num_inputs(self, number: int) -> int:
        """How many views of a scene the model sees."""
        count = self.scenes.num_views(number)
        return count if self.variant == "reference" else min(count, self.frames)

    def _seconds(self, images: Path) -> tuple[float, float]:
        """The mean seconds of one scene in one style, and of one of its input images."""
        seconds, per_image = [], []
        for number, scene in self.plan.scenes:
            for _, style in self.plan.styles:
                file = seconds_file(images / "stylized" / scene, style)
                seconds.append(read_seconds(file))
                per_image.append(seconds[-1] / self._num_inputs(number))
        return sum(seconds) / len(seconds), sum(per_image) / len(per_image)


def suffix_of(variant: Variant) -> str:
    """Of the image files that a variant writes."""
    return ".jpg" if variant == "reference" else ".png"


def write_picture(path: Path, image: Float[Tensor, "3 H W"], variant: Variant) -> None:
    """Write an image of values in [0, 1], others clamped: ``reference`` as JPEG of quality 75, else as PNG."""
    values = image.detach().clamp(0, 1) * 255
    # The published scripts cut decimals off, and darken by half a step on average.
    values = values if variant == "reference" else values.round()
    picture = Image.fromarray(np.ascontiguousarray(values.byte().permute(1, 2, 0).cpu().numpy()))
    with atomic_path(path) as temporary:
        if variant == "reference":
            picture.save(temporary, quality=75, subsampling="4:2:0")
        else:
            picture.save(temporary)


def middle_square(views: Views) -> Views:
    """The middle square of every view; cameras are moved with it, and depth is cut alike."""
    height, width = views.size
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    rows, columns = slice(top, top + side), slice(left, left + side)
    cameras = views.cameras
    if cameras is not None:
        shift = torch.zeros_like(cameras.intrinsics)
        shift[..., 0, 2], shift[..., 1, 2] = left, top
        cameras = replace(cameras, intrinsics=cameras.intrinsics - shift, size=(side, side))
    depth = None if views.depth is None else views.depth[..., rows, columns]
    return replace(views, images=views.images[..., rows, columns], cameras=cameras, depth=depth)
