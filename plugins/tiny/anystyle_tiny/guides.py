"""A model on scenes and styles, every style given as its text and as its image: how variants are set side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import torch

from anystyle.contracts import Metric, SceneSource, StyleSource
from anystyle.contracts.protocol import Evaluation, Protocol, required
from anystyle.errors import UserError
from anystyle.evaluation.judge import SceneFigures, aggregate, judge_scene, mean
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import to_pil
from anystyle.ranges import AtLeastOne
from anystyle.stylizer import Stylizer
from anystyle.types import Comparison, OnProgress, Progress, Scene, Style, Views

GUIDES = ("text", "image")
T = TypeVar("T")
DEPTH_CHANGE = "depth_change"


class TextAndImage(Protocol):
    """Stylize every scene in every style, once by its text and once by its image, and judge the renders themselves.

    Every score is given twice, with ``_text`` and ``_image`` behind its name. Metrics see the depth of the
    stylized scene, so that a style that moves or hides Gaussians changes it. Beside those of the metrics there is
    ``depth_change``: the mean absolute difference of the logarithms of the depth of styled and unstyled renders.

    Args:
        styles: Every style has an image and a text.
        num_scenes: How many scenes, from the first on.
        num_styles: How many styles, from the first on.
        num_views: How many views of each scene are encoded and evaluated, from the first on.
    """

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"num_scenes": 2, "num_styles": 2, "num_views": 2}

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        metrics: Mapping[str, Metric],
        scenes: SceneSource | None,
        styles: StyleSource | None,
        num_scenes: AtLeastOne = 4,
        num_styles: AtLeastOne = 10,
        num_views: AtLeastOne = 3,
    ) -> None:
        self.stylizer = stylizer
        self.metrics = dict(metrics)
        self.scenes, self.styles = required(scenes, "scenes"), required(styles, "styles")
        self.num_scenes, self.num_styles = min(num_scenes, len(self.scenes)), min(num_styles, len(self.styles))
        self.num_views = num_views

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        options = {name: getattr(self, name) for name in ("num_scenes", "num_styles", "num_views")}
        figures: dict[str, dict[str, SceneFigures]] = {}
        runs = [(scene, guide) for scene in range(self.num_scenes) for guide in GUIDES]
        for done, (scene, guide) in enumerate(runs):
            on_progress(Progress.count("scenes", done, len(runs)))
            judged = {f"{name}_{guide}": _named(guide, each) for name, each in self._judge(scene, guide, out).items()}
            figures.setdefault(self.scenes.name(scene), {}).update(judged)
        on_progress(Progress.count("scenes", len(runs), len(runs)))
        images = self.num_styles * sum(len(self._views(scene)) for scene, _ in runs)
        return aggregate(figures, n=images).with_facts(guides=list(GUIDES), **options)

    def _views(self, scene: int) -> range:
        return range(min(self.num_views, self.scenes.num_views(scene)))

    def _judge(self, scene: int, guide: str, out: Path) -> dict[str, SceneFigures]:
        """The scores of one scene in all styles."""
        encoded = self._encode(scene)
        comparisons = self._stylize(scene, encoded, guide)
        if guide == GUIDES[0]:
            _write_pictures(out / "images", comparisons)
        return judge_scene(self.metrics, comparisons) | {DEPTH_CHANGE: self._depth_change(encoded, comparisons)}

    @torch.no_grad()
    def _encode(self, index: int) -> Scene:
        views = self.scenes.read(index, self._views(index))
        # Only the photographs: the model predicts cameras and depth.
        return self.stylizer.encode(Views(images=views.images.to(self.stylizer.device)))

    @cached_property
    def _all_styles(self) -> tuple[Style, ...]:
        read = tuple(self.styles.read(index).to(self.stylizer.device) for index in range(self.num_styles))
        for index, style in enumerate(read):
            if style.image is None or not (style.text and style.text[0].strip()):
                raise UserError(f"style {index} lacks its image or its text; this protocol gives each style as both")
        return read

    @torch.no_grad()
    def _stylize(self, index: int, scene: Scene, guide: str) -> list[Comparison]:
        """Renders in every style beside the photographs."""
        images, name = scene.views.images, self.scenes.name(index)
        plain = Comparison(images, images, cameras=scene.cameras, scenes=(name,))
        comparisons, stylizer = [], self.stylizer
        for number, style in enumerate(self._all_styles):
            embedding = stylizer.embed(text=style.text) if guide == "text" else stylizer.embed(image=style.image)
            renders = stylizer.render(stylizer.restyle(scene, embedding), scene.cameras)
            depth = renders.depth / renders.alpha.clamp_min(1e-6)
            stylized = renders.color.clamp(0, 1)
            comparisons.append(replace(plain, stylized=stylized, style=style, depth=depth, styles=(f"{number:02d}",)))
        return comparisons

    @torch.no_grad()
    def _depth_change(self, scene: Scene, comparisons: Sequence[Comparison]) -> SceneFigures:
        renders = self.stylizer.render(self.stylizer.unstyled(scene), scene.cameras)
        unstyled = (renders.depth / renders.alpha.clamp_min(1e-6))[0]
        styles = {}
        for comparison in comparisons:
            assert comparison.depth is not None
            change = (comparison.depth[0].clamp_min(1e-6) / unstyled.clamp_min(1e-6)).log().abs().mean()
            styles[comparison.styles[0]] = {DEPTH_CHANGE: float(change)}
        overall = mean([row[DEPTH_CHANGE] for row in styles.values()])
        return SceneFigures({DEPTH_CHANGE: overall}, styles, {DEPTH_CHANGE: "lower"})


def _write_pictures(images: Path, comparisons: Sequence[Comparison]) -> None:
    """Write the pictures that a report's sheet is made of."""
    for comparison in comparisons:
        (scene,), (style,) = comparison.scenes, comparison.styles
        assert comparison.style is not None and comparison.style.image is not None
        files = [(images / "style" / f"{style}.png", comparison.style.image[0])]
        folder = images / "stylized" / scene
        files += [(folder / f"{style}_{view:03d}.png", image) for view, image in enumerate(comparison.stylized[0])]
        for path, image in files:
            with atomic_path(path) as temporary:
                to_pil(image).save(temporary)


def _named(guide: str, one: SceneFigures) -> SceneFigures:
    """Scores with the guide behind their names."""

    def named(values: Mapping[str, T]) -> dict[str, T]:
        return {f"{name}_{guide}": value for name, value in values.items()}

    styles = {style: named(figures) for style, figures in one.styles.items()}
    return SceneFigures(named(one.figures), styles, named(one.better), named(one.stand_ins), one.warned)
