"""A model on scenes and styles, every style given as its text and as its image: how variants are set side by side."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from anystyle.contracts import Metric, SceneSource, StyleSource
from anystyle.evaluation import resume
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, Row, required
from anystyle.evaluation.runner import SceneFigures, aggregate, judge_scene, mean
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import to_pil
from anystyle.stylizer import Stylizer
from anystyle.types import Comparison, Scene, Style, StyleEmbedding, Views

GUIDES = ("text", "image")
DEPTH_CHANGE = "depth_change"


class Guides(Protocol):
    """Stylize every scene in every style, once by its text and once by its image, and judge the renders themselves.

    Every figure is given twice, with ``_text`` and ``_image`` behind its name. Metrics see the depth that the stylized
    scene has, so that a style that moves or hides Gaussians shows in it. Beside those of the metrics there is
    ``depth_change``: the mean absolute difference of the logarithms of the depth of styled and unstyled renders.

    Args:
        styles: Every style has an image and a text.
        num_scenes: Of the scenes, the first so many.
        num_styles: Of the styles, the first so many.
        num_views: Of each scene, the first so many are seen and judged.

    Raises:
        ValueError: A number is below 1, or a source is not configured.
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
        num_scenes: int = 4,
        num_styles: int = 10,
        num_views: int = 3,
    ) -> None:
        for name, value in (("num_scenes", num_scenes), ("num_styles", num_styles), ("num_views", num_views)):
            if value < 1:
                raise ValueError(f"{name}={value}: give at least 1")
        self.stylizer = stylizer
        self.metrics = dict(metrics)
        self.scenes, self.styles = required(scenes, "scenes"), required(styles, "styles")
        self.num_scenes, self.num_styles = min(num_scenes, len(self.scenes)), min(num_styles, len(self.styles))
        self.num_views = num_views

    def run(self, out: Path, progress: Progress) -> Evaluation:
        options = {name: getattr(self, name) for name in ("num_scenes", "num_styles", "num_views")}
        figures: dict[str, dict[str, dict[str, SceneFigures]]] = {guide: {} for guide in GUIDES}
        done, total = 0, len(GUIDES) * self.num_scenes
        for scene in range(self.num_scenes):
            name = self.scenes.name(scene)
            for guide in GUIDES:
                progress("scenes", done, total)
                figures[guide][name] = _OneScene(self, scene, guide).figures(out, str(options))
                done += 1
        progress("scenes", total, total)
        images = self.num_styles * sum(len(self.shown(scene)) for scene in range(self.num_scenes))
        return _together({guide: aggregate(scenes, n=images) for guide, scenes in figures.items()}).with_facts(
            **options
        )

    def shown(self, scene: int) -> range:
        """The views of a scene that are judged."""
        return range(min(self.num_views, self.scenes.num_views(scene)))

    @cached_property
    def all_styles(self) -> tuple[Style, ...]:
        """The styles, in order.

        Raises:
            ValueError: One lacks its image or its text.
        """
        read = tuple(self.styles.read(index).to(self.stylizer.device) for index in range(self.num_styles))
        for index, style in enumerate(read):
            if style.image is None or not (style.text and style.text[0].strip()):
                raise ValueError(f"style {index} lacks its image or its text; this protocol gives each style as both")
        return read

    def embed(self, style: Style, guide: str) -> StyleEmbedding:
        """A style as its text or as its image."""
        return self.stylizer.embed(text=style.text) if guide == "text" else self.stylizer.embed(image=style.image)


class _OneScene:
    """One scene in all styles, given in one way; encoded and rendered when the first figure is missing."""

    def __init__(self, protocol: Guides, index: int, guide: str) -> None:
        self.protocol, self.index, self.guide = protocol, index, guide
        self.name = protocol.scenes.name(index)

    def figures(self, out: Path, digest: str) -> dict[str, SceneFigures]:
        """What the metrics and the protocol say, as far as it is not known from files."""
        figures: dict[str, SceneFigures] = {}
        for name in (*self.protocol.metrics, DEPTH_CHANGE):
            file = resume.figures_file(out, name, f"{self.name}-{self.guide}")
            stored = resume.read_figures(file, digest)
            if stored is None:
                stored = self._depth_change(out) if name == DEPTH_CHANGE else self._judged(name)
                resume.write_figures(file, digest, stored)
            figures[name] = stored
        return figures

    def _judged(self, name: str) -> SceneFigures:
        return judge_scene({name: self.protocol.metrics[name]}, self.comparisons)[name]

    @torch.no_grad()
    def _depth_change(self, out: Path) -> SceneFigures:
        protocol, styles = self.protocol, {}
        renders = protocol.stylizer.render(protocol.stylizer.unstyled(self.scene), self.scene.cameras)
        unstyled = (renders.depth / renders.alpha.clamp_min(1e-6))[0]
        for comparison in self.comparisons:
            assert comparison.depth is not None
            change = (comparison.depth[0].clamp_min(1e-6) / unstyled.clamp_min(1e-6)).log().abs().mean()
            styles[comparison.styles[0]] = {DEPTH_CHANGE: float(change)}
            if self.guide == GUIDES[0]:
                self._keep(out / "images", comparison)
        overall = mean([row[DEPTH_CHANGE] for row in styles.values()])
        return SceneFigures({DEPTH_CHANGE: overall}, styles, {DEPTH_CHANGE: "lower"})

    def _keep(self, images: Path, comparison: Comparison) -> None:
        """Write the pictures that a report's sheet is made of: those of text-guided scenes."""
        (scene,), (style,) = comparison.scenes, comparison.styles
        assert comparison.style is not None
        assert comparison.style.image is not None
        _write(images / "style" / f"{style}.png", comparison.style.image[0])
        for view, image in enumerate(comparison.stylized[0]):
            _write(images / "stylized" / scene / f"{style}_{view:03d}.png", image)

    @cached_property
    @torch.no_grad()
    def scene(self) -> Scene:
        """What the model makes of the photographs, of which it is told nothing else."""
        protocol = self.protocol
        views = protocol.scenes.read(self.index, protocol.shown(self.index))
        patch = protocol.stylizer.backbone.patch_size
        if any(side % patch for side in views.size):
            raise ValueError(
                f"the views of {self.name} are {views.size[1]}x{views.size[0]} pixels; this model needs sides that are "
                f"multiples of {patch} (an option of the scenes)"
            )
        return protocol.stylizer.encode(Views(images=views.images.to(protocol.stylizer.device)))

    @cached_property
    def comparisons(self) -> Sequence[Comparison]:
        """Its renders in every style beside its photographs."""
        return list(self._compared())

    @torch.no_grad()
    def _compared(self) -> Iterator[Comparison]:
        stylizer, scene = self.protocol.stylizer, self.scene
        for index, style in enumerate(self.protocol.all_styles):
            renders = stylizer.render(stylizer.restyle(scene, self.protocol.embed(style, self.guide)), scene.cameras)
            yield Comparison(
                content=scene.views.images,
                stylized=renders.color.clamp(0, 1),
                style=style,
                cameras=scene.cameras,
                depth=renders.depth / renders.alpha.clamp_min(1e-6),
                scenes=(self.name,),
                styles=(f"{index:02d}",),
            )


def _together(evaluations: Mapping[str, Evaluation]) -> Evaluation:
    """The evaluations of all guides as one, each guide behind the names of its figures."""

    def named(guide: str, figures: Mapping[str, float]) -> dict[str, float]:
        return {f"{name}_{guide}": value for name, value in figures.items()}

    first = next(iter(evaluations.values()))
    groups: dict[str, dict[str, float]] = {}
    rows: dict[tuple[str, str], dict[str, float]] = {}
    warned: list[str] = []
    for guide, each in evaluations.items():
        for group, figures in each.groups.items():
            groups.setdefault(group, {}).update(named(guide, figures))
        for row in each.rows:
            rows.setdefault((row.scene, row.style), {}).update(named(guide, row.figures))
        warned += each.provenance["warnings"]
    return replace(
        first,
        figures={k: v for guide, each in evaluations.items() for k, v in named(guide, each.figures).items()},
        n=sum(each.n for each in evaluations.values()),
        better={f"{name}_{guide}": way for guide, each in evaluations.items() for name, way in each.better.items()},
        stand_ins={f"{name}_{guide}": by for guide, each in evaluations.items() for name, by in each.stand_ins.items()},
        groups=groups,
        rows=tuple(Row(scene, style, figures) for (scene, style), figures in rows.items()),
        provenance={**first.provenance, "warnings": list(dict.fromkeys(warned)), "guides": list(evaluations)},
    )


def _write(path: Path, image: Tensor) -> None:
    with atomic_path(path) as temporary:
        to_pil(image).save(temporary)
