"""Contrast: the smallest protocol."""

import json
from pathlib import Path

import torch

from anystyle.contracts import SceneSource, StyleSource
from anystyle.evaluation.contract import Evaluation, Progress, Protocol, Row, required
from anystyle.io.atomic import atomic_path
from anystyle.stylizer import Stylizer


class ToyProtocol(Protocol):
    """How much the contrast of the renders differs from that of the photographs, styled and unstyled.

    Args:
        stylizer: What is judged; the framework passes it.
        scenes: What it is judged on; likewise.
        styles: In which styles; likewise.
        num_scenes: How many of the scenes.
        num_styles: How many of the styles.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        scenes: SceneSource | None,
        styles: StyleSource | None,
        num_scenes: int = 2,
        num_styles: int = 2,
    ) -> None:
        self.stylizer = stylizer
        self.scenes = required(scenes, "scenes")
        self.styles = required(styles, "styles")
        self.num_scenes = min(num_scenes, len(self.scenes))
        self.num_styles = min(num_styles, len(self.styles))

    def run(self, out: Path, progress: Progress) -> Evaluation:
        """See :meth:`anystyle.evaluation.contract.Protocol.run`."""
        records: list[dict[str, float]] = []
        for scene in range(self.num_scenes):
            progress("scenes", scene, self.num_scenes)
            kept = out / f"{self.scenes.name(scene)}.json"
            if not kept.is_file():
                with atomic_path(kept) as temporary:
                    temporary.write_text(json.dumps(self._judge(scene)))
            records.append(json.loads(kept.read_text()))
        progress("scenes", self.num_scenes, self.num_scenes)
        rows = tuple(
            Row(self.scenes.name(scene), name, {"contrast_change": value})
            for scene, values in enumerate(records)
            for name, value in values.items()
            if name != "unstyled"
        )
        return Evaluation(
            figures={"contrast_change": sum(row.figures["contrast_change"] for row in rows) / len(rows)},
            n=len(rows),
            better={"contrast_change": "lower"},
            groups={"baseline": {"contrast_change": sum(values["unstyled"] for values in records) / len(records)}},
            rows=rows,
            provenance={"num_scenes": self.num_scenes, "num_styles": self.num_styles},
        )

    @torch.no_grad()
    def _judge(self, number: int) -> dict[str, float]:
        views = self.scenes.read(number, range(self.scenes.num_views(number)))
        scene = self.stylizer.encode(views)
        results = {"unstyled": self.stylizer.unstyled(scene)}
        for index in range(self.num_styles):
            style = self.styles.read(index)
            results[style.names[0]] = self.stylizer.restyle(scene, self.stylizer.embed(image=style.image))
        contrast = views.images.std()
        return {
            name: float((self.stylizer.render(gaussians, scene.cameras).color.std() - contrast).abs())
            for name, gaussians in results.items()
        }
