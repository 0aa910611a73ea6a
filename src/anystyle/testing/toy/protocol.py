"""Contrast: the smallest protocol."""

import json
from pathlib import Path

import torch

from anystyle.contracts import SceneSource, StyleSource
from anystyle.contracts.protocol import Evaluation, Protocol, Row
from anystyle.contracts.scene import required
from anystyle.io.atomic import write_json
from anystyle.stylizer import Stylizer
from anystyle.types import OnProgress, Progress


class ToyProtocol(Protocol):
    """How much the contrast of the renders in a style differs from that of the photographs.

    Args:
        stylizer: What is judged; the framework passes it.
        scenes: What it is judged on; likewise.
        styles: The first of them is the style; likewise.
        num_scenes: How many of the scenes.
    """

    def __init__(
        self, *, stylizer: Stylizer, scenes: SceneSource | None, styles: StyleSource | None, num_scenes: int = 2
    ) -> None:
        self.stylizer = stylizer
        self.scenes = required(scenes, "scenes")
        self.style = required(styles, "styles").read(0)
        self.num_scenes = min(num_scenes, len(self.scenes))

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        rows: list[Row] = []
        for scene in range(self.num_scenes):
            on_progress(Progress.count("scenes", scene, self.num_scenes))
            kept = out / f"{self.scenes.name(scene)}.json"
            if not kept.is_file():
                write_json(kept, {"contrast_change": self._judge(scene)})
            rows.append(Row(self.scenes.name(scene), self.style.names[0], json.loads(kept.read_text())))
        on_progress(Progress.count("scenes", self.num_scenes, self.num_scenes))
        mean = sum(row.scores["contrast_change"] for row in rows) / len(rows)
        better = {"contrast_change": "lower"}
        return Evaluation(scores={"contrast_change": mean}, n=len(rows), better=better, rows=tuple(rows))

    @torch.no_grad()
    def _judge(self, scene: int) -> float:
        views = self.scenes.read(scene, range(self.scenes.num_views(scene)))
        encoded = self.stylizer.encode(views)
        styled = self.stylizer.restyle(encoded, self.stylizer.embed(image=self.style.image))
        return float((self.stylizer.render(styled, encoded.cameras).color.std() - views.images.std()).abs())
