"""CLIP directional: the change of every view points where the style lies."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss, StyleEncoder
from anystyle.losses._features import Reference, reference_images
from anystyle.types import Stylization


class ClipDirectional(Loss):
    """Move every view, in the style encoder's space, in the direction of the style (paper, equation 9).

    ``mean (1 - cos(E(render) - E(photograph), d))`` with ``d`` the style's direction from the neutral prompt.

    Args:
        size: Side that images are squashed to before, bicubic as published; none leaves that to the encoder.
        reference: What ``photograph`` stands for above: the photograph, as published, or the unstyled ``render``.
        weight: In the objective.
    """

    def __init__(
        self,
        *,
        style_encoder: StyleEncoder,
        size: int | None = 224,
        reference: Reference = "photograph",
        weight: float = 2.0,
    ) -> None:
        super().__init__()
        # Held, not owned: it is neither learnt here nor repeated in this loss's state dict.
        self._encoder = (style_encoder,)
        self.size = size
        self.reference: Reference = reference
        self.needs_unstyled = reference == "render"
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        before_images = reference_images(result, self.reference).flatten(0, 1)
        after_images = result.renders.color.flatten(0, 1)
        with torch.no_grad():
            before = self._embed(before_images)
        # The floor keeps the gradient bounded where a view has not changed at all.
        change = F.normalize(self._embed(after_images) - before, dim=-1, eps=1e-4)
        direction = F.normalize(result.embedding.direction, dim=-1)
        return (1 - (change * direction.repeat_interleave(result.renders.color.shape[1], 0)).sum(-1)).mean()

    def _embed(self, images: Tensor) -> Tensor:
        if self.size is not None and images.shape[-2:] != (self.size, self.size):
            images = F.interpolate(images, size=(self.size, self.size), mode="bicubic", align_corners=False)
        return self._encoder[0].embed_images(images)
