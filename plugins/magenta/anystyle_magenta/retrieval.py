"""Style retrieval by the style prediction network."""

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.vision.weights import checksums
from anystyle_magenta.networks import StylePrediction
from anystyle_magenta.pretrained import load_prediction
from anystyle_magenta.style_encoder import centre_square
from anystyle_metrics.style_retrieval import Retrieval
from anystyle_metrics.style_sets import named


class MagentaRetrieval(Retrieval):
    """:class:`~anystyle_metrics.style_retrieval.Retrieval` by the 100 numbers of Magenta's prediction network.

    An independent judge of models trained with EfficientNet-Lite0, but not of ``model=painter``, which uses it.

    Example:
        >>> fine = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> images = torch.cat([fine, fine[..., :4, :4].repeat_interleave(16, -1).repeat_interleave(16, -2)])
        >>> metric = MagentaRetrieval()
        >>> metric.update(images, images)
        >>> metric.compute()["magenta_retrieval"]  # results are their style images
        tensor(1.)
    """

    better: ClassVar[Mapping[str, str]] = named("magenta_retrieval", "magenta_retrieval_gray")

    def __init__(self) -> None:
        super().__init__()
        self.network = StylePrediction().eval()
        self.weights = checksums(load_prediction(self.network))
        self.network.requires_grad_(False)

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        return self.network(centre_square(images))
