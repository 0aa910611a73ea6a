"""CLIP directional: align the change of every view with the direction of the style."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss, StyleEncoder
from anystyle.losses.features import Reference, reference_embeddings, resized
from anystyle.types import Stylization


class ClipDirectional(Loss):
    """Move every view, in the style encoder's space, in the direction of the style (paper, equation 9).

    ``mean (1 - cos(E(render) - E(photograph), d))`` with ``d`` the style's direction from the neutral prompt.

    Args:
        size: Side that images are first resized to, bicubic as published; ``None`` leaves that to the encoder.
        reference: What ``photograph`` stands for above: the photograph, as published, or the unstyled ``render``.
        weight: In the objective.

    Example:
        >>> result = inputs.stylization()
        >>> same = replace(result, renders=replace(result.renders, color=result.views.images))
        >>> ClipDirectional(style_encoder=inputs.style_encoder())(same)  # nothing changed, in no direction
        tensor(1.)
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
        # In a tuple, so that it is not a submodule: neither trained here nor repeated in this loss's state dict.
        self._encoder = (style_encoder,)
        self.size, self.weight = size, weight
        self.reference: Reference = reference
        self.needs_unstyled = reference == "render"

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        after_images = result.renders.color.flatten(0, 1)
        embed = self._encoder[0].embed_images
        before = reference_embeddings(result, self.reference, self._encoder[0], self.size)
        # eps bounds the gradient where a view has not changed at all.
        change = F.normalize(embed(resized(after_images, self.size, "bicubic")) - before, dim=-1, eps=1e-4)
        direction = F.normalize(result.embedding.direction, dim=-1)
        return (1 - (change * direction.repeat_interleave(result.renders.color.shape[1], 0)).sum(-1)).mean()
