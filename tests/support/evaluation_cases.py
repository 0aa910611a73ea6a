"""What the tests of evaluations share: small pictures in folders, and metrics whose values are known."""

from pathlib import Path
from typing import ClassVar

import torch

from anystyle.contracts import Metric
from tests.support.pictures import picture


class Mean(Metric):
    """The mean value of stylized images, and how many there were."""

    better: ClassVar[dict[str, str]] = {"mean": "higher"}
    full_state_update = False

    def __init__(self, score="mean", stand_in=None):
        super().__init__()
        if score != "mean":
            self.better = {score: "higher"}
        self.score = score
        if stand_in:
            self.stand_ins = {score: stand_in}
        self.seen = []
        self.add_state("values", [], dist_reduce_fx="cat")

    def update(self, comparison):
        self.seen.append((comparison.scenes[0], comparison.styles[0]))
        self.values.append(comparison.stylized.mean((-1, -2, -3)).flatten())

    def compute(self):
        values = torch.cat([value.reshape(-1) for value in self.values]) if self.values else torch.zeros(0)
        return {self.score: values.mean()}


def folders(root: Path, scenes=("one", "two"), styles=("a", "b"), frames=3):
    """Content, style and stylized folders; the value of a result counts scenes, styles and frames."""
    for s, scene in enumerate(scenes):
        for f in range(frames):
            picture(root / "content" / scene / f"{f:03d}.png", 100 + f)
            for t, style in enumerate(styles):
                picture(root / "stylized" / scene / f"{style}_{f}.png", 60 * s + 20 * t + f)
    for t, style in enumerate(styles):
        picture(root / "style" / f"{style}.png", 200 + t, size=(6, 6))
    return root / "content", root / "style", root / "stylized"
