"""Content: keep what the photographs show."""

from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.contracts import Loss
from anystyle.perception.compare import squash
from anystyle.perception.early import differentiated
from anystyle.types import Stylization


class Content(Loss):
    """Keep the VGG features of the photographs (paper section 3.3).

    ``sum_l mean (phi_l(render) - phi_l(photograph))^2``.

    Args:
        network: A network of :func:`anystyle.perception.load`.
        layers: Which features.
        size: Side that renders and photographs are squashed to; none keeps them as they are.
        weight: In the objective; published as 0.05 for the head variant, 0.075 for the aggregator variant.
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu3_1", "relu4_1"),
        size: int | None = 224,
        weight: float = 0.05,
    ) -> None:
        super().__init__()
        self.network = perception.load(network)
        self.layers = tuple(layers)
        self.size = size
        self.weight = weight

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """The bundled network, on small pictures."""
        return {"network": "texture", "layers": ("relu3_1", "relu4_1"), "size": 48}

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        with torch.no_grad():
            wanted = self.network(squash(result.views.images.flatten(0, 1), self.size), self.layers)

        def distance(images: Tensor) -> Tensor:
            found = self.network(squash(images, self.size), self.layers)
            return torch.stack([F.mse_loss(*pair) for pair in zip(found, wanted, strict=True)]).sum()

        return differentiated(distance, result.renders.color.flatten(0, 1))
