"""The bundled model on scenes and styles of the procedural world that training never sees."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, Row
from anystyle.inference.refine import refine
from anystyle.io.checkpoint import Header, save_part
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer
from anystyle.types import Scene, Views
from anystyle_tiny.evaluation.geometry import baseline_record, geometry_record
from anystyle_tiny.evaluation.records import (
    BETTER,
    FOLDER,
    Record,
    baseline_figures,
    geometry_figures,
    kept,
    seal,
    style_figures,
)
from anystyle_tiny.evaluation.styles import Targets, histograms, load_judge, strip_record, style_record
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.styles import ProceduralStyles
from anystyle_tiny.training.styles import retrieval

INPUTS, NOVEL = (0, 2, 3, 5), (1, 4)
"""Which of a scene's six views the model is shown, and which it is not."""


class TinyHeldout(Protocol):
    """Figures of reconstruction and of style on held-out procedural scenes and held-out combinations of style.

    Every figure is of a single pass; with ``refine`` those of geometry are given again with ``_refined`` behind their
    names, after the test-time alignment of cameras. Who judges styles is a network that no model is trained by.

    Args:
        stylizer: What is judged; the framework passes it.
        judge: The judge's weights: a name of :func:`anystyle.perception.weights.files`, or a file.
        num_scenes: Held-out scenes.
        num_styles: Held-out styles, each put on every scene once by its image and once by its caption.
        num_captions: Held-out styles among whose captions the model's own embedding finds that of each image.
        style_views: How many input views are rendered in every style.
        strips: Scenes with an interpolation between two styles; at most ``num_scenes``.
        steps: Of an interpolation.
        seed: Of scenes and styles.
        size: Side of the images in pixels; ``None`` is what the backbone is made for.
        refine: Whether cameras are refined too.

    Raises:
        ValueError: A number is below 1, or the judge's weights do not fit.
        FileNotFoundError: The judge's weights are missing.
    """

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Two scenes of 16 pixels and two styles, judged by a network that has learnt nothing."""
        options = {"dim": 8, "widths": (8, 8), "colors": 8, "text_width": 8, "buckets": 64}
        node = {"_target_": catalog().find("style_encoder", "judge").path, **options}
        file = folder / "judge.safetensors"
        save_part(file, build(StyleEncoder, node), Header(part="style_encoder", config={"style_encoder": node}))
        counts = {"num_scenes": 2, "num_styles": 2, "num_captions": 4, "strips": 1, "steps": 2}
        return {"judge": str(file), "size": 16, **counts}

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        judge: str = "tiny_judge",
        num_scenes: int = 100,
        num_styles: int = 20,
        num_captions: int = 100,
        style_views: int = 2,
        strips: int = 100,
        steps: int = 9,
        seed: int = 0,
        size: int | None = None,
        refine: bool = False,
    ) -> None:
        numbers = {"num_scenes": num_scenes, "num_styles": num_styles, "num_captions": num_captions, "steps": steps}
        for name, value in (numbers | {"style_views": style_views}).items():
            if value < 1:
                raise ValueError(f"{name}={value}: give at least 1")
        self.stylizer = stylizer
        self.judge = load_judge(judge).to(next(stylizer.parameters()).device)
        self.num_scenes, self.num_styles, self.num_captions = num_scenes, num_styles, num_captions
        self.style_views, self.strips, self.steps = style_views, min(strips, num_scenes), steps
        self.refines = refine
        side = size or stylizer.backbone.resolution
        self.scenes = ProceduralScenes(size=side, num_scenes=num_scenes, seed=seed, split="heldout")
        self.styles = ProceduralStyles(size=96, num_styles=max(num_styles, num_captions), seed=seed, split="heldout")
        self.options = {
            "seed": seed,
            "size": side,
            "num_styles": num_styles,
            "style_views": style_views,
            "steps": steps,
        }

    @torch.no_grad()
    def run(self, out: Path, progress: Progress) -> Evaluation:
        """See :meth:`anystyle.evaluation.contract.Protocol.run`."""
        mark = seal([self.stylizer, self.judge], self.options)
        geometry: list[Record] = []
        styles: list[Record] = []
        strips: list[Record] = []
        refined: list[Record] = []
        for scene in range(self.num_scenes):
            progress("scenes", scene, self.num_scenes)
            folder = out / FOLDER / self.scenes.name(scene)
            one = _OneScene(self, scene)
            geometry.append(kept(folder / "geometry.json", mark, one.geometry))
            if self.refines:
                refined.append(kept(folder / "refined.json", mark, one.refined))
            styles.append(kept(folder / "styles.json", mark, one.styles))
            if scene < self.strips:
                strips.append(kept(folder / "strip.json", mark, one.strip))
        progress("scenes", self.num_scenes, self.num_scenes)
        return self._evaluation(geometry, refined, styles, strips)

    def _evaluation(
        self, geometry: list[Record], refined: list[Record], styles: list[Record], strips: list[Record]
    ) -> Evaluation:
        styled, unstyled = style_figures(
            [record["styles"] for record in styles], [record["strip"] for record in strips], self.num_styles
        )
        figures = self._retrieval() | geometry_figures([record["scene"] for record in geometry]) | styled
        for name, value in geometry_figures([record["scene"] for record in refined]).items() if refined else ():
            figures[f"{name}_refined"] = value
        chance = 1.0 / self.num_captions
        baseline = {"retrieval_text_to_image": chance, "retrieval_image_to_text": chance}
        baseline |= baseline_figures([record["baseline"] for record in geometry]) | unstyled
        rows = [
            Row(self.scenes.name(scene), "", geometry_figures([record["scene"]]))
            for scene, record in enumerate(geometry)
        ]
        return Evaluation(
            figures=figures,
            n=self.num_scenes,
            better={name: BETTER[name.removesuffix("_refined")] for name in figures},
            groups={"baseline": baseline, "judge": self._reliability()},
            rows=tuple(rows),
            provenance={
                "sample": "scenes",
                "num_styles": self.num_styles,
                "style_views": self.style_views,
                "strips": self.strips,
                "input_views": len(INPUTS),
                "variant": "single pass" if not self.refines else "single pass; _refined after test-time alignment",
                **self.options,
                "baseline": "constant depth and the constant camera motion that fit these scenes best; the mean colour "
                "of the input views; unstyled renders",
                "novel_views": "true cameras, moved by the similarity from the true to the predicted input cameras",
            },
        )

    def _read(self, styles: int) -> tuple[Float[Tensor, "S 3 h w"], list[str]]:
        read = [self.styles.read(style) for style in range(styles)]
        device = next(self.stylizer.parameters()).device
        images = torch.cat([style.image for style in read if style.image is not None]).to(device)
        return images, [style.text[0] for style in read if style.text is not None]

    @cached_property
    def targets(self) -> Targets:
        """What renders are held against; embedded once."""
        images, texts = self._read(self.num_styles)
        return Targets(
            judged_images=self.judge.embed_images(images),
            judged_texts=self.judge.embed_texts(texts),
            by_image=self.stylizer.embed(image=images),
            by_text=self.stylizer.embed(text=texts),
            histograms=histograms(images),
            palettes=tuple(self.styles.traits(style).palette.to(images.device) for style in range(self.num_styles)),
        )

    def _retrieval(self) -> dict[str, float]:
        """How often the model's embedding finds the image of a caption, and the caption of an image."""
        return self._retrieved(self.stylizer.style_encoder, self.num_captions)

    def _reliability(self) -> dict[str, float]:
        """The same of the judge, among the captions and among the styles that are put on scenes."""
        return {
            f"{name}_{among}": value
            for among, count in (("captions", self.num_captions), ("styles", self.num_styles))
            for name, value in self._retrieved(self.judge, count).items()
        }

    def _retrieved(self, encoder: StyleEncoder, count: int) -> dict[str, float]:
        images, texts = self._read(count)
        figures = retrieval(encoder.embed_images(images), encoder.embed_texts(texts))
        return {name: float(value) for name, value in figures.items()}


class _OneScene:
    """One held-out scene, read and encoded when it is first needed."""

    def __init__(self, protocol: TinyHeldout, scene: int) -> None:
        self.protocol, self.scene = protocol, scene

    @cached_property
    def views(self) -> Views:
        """All views, with true cameras and depth."""
        device = next(self.protocol.stylizer.parameters()).device
        return self.protocol.scenes.read(self.scene, range(self.protocol.scenes.views)).to(device)

    @cached_property
    def inputs(self) -> Views:
        """The views that the model is shown."""
        return self.views.select(list(INPUTS))

    @cached_property
    def encoded(self) -> Scene:
        """What the model makes of them, of which it is told nothing else."""
        return self.protocol.stylizer.encode(replace(self.inputs, cameras=None, depth=None))

    def geometry(self) -> Record:
        novel = self.views.select(list(NOVEL))
        record = geometry_record(self.protocol.stylizer, self.encoded, self.inputs, novel)
        return {"scene": record, "baseline": baseline_record(self.inputs, novel)}

    def refined(self) -> Record:
        stylizer = self.protocol.stylizer
        scene = refine(self.encoded, stylizer.backbone.adapter)
        return {"scene": geometry_record(stylizer, scene, self.inputs, self.views.select(list(NOVEL)))}

    def styles(self) -> Record:
        protocol = self.protocol
        cameras = self.encoded.cameras.select(list(range(min(protocol.style_views, len(INPUTS)))))
        return {"styles": style_record(protocol.stylizer, protocol.judge, self.encoded, cameras, protocol.targets)}

    def strip(self) -> Record:
        count = self.protocol.num_styles
        first, further = self.scene % count, 1 + self.scene // count
        pair = (first, (first + further) % count)
        protocol = self.protocol
        return {"strip": strip_record(protocol.stylizer, self.encoded, protocol.targets, pair, protocol.steps)}
