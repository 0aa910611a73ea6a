"""The single pass."""

from collections.abc import Callable

import torch

from anystyle.methods.contract import Method, Progress, silent
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding


class Branch(Method):
    """What the style branch predicts in a single pass, as in the paper."""

    @torch.no_grad()
    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: Callable[[Progress], None] = silent,
    ) -> Gaussians:
        return stylizer.restyle(scene, embedding)
