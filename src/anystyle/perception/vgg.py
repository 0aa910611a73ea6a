"""VGG-19 (Simonyan and Zisserman 2015, configuration E), the network of the paper's style and content losses."""

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception.features import RGB, FeatureNetwork, walk

BLOCKS = ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4))
"""Channels and convolutions of each block; a maximum pooling follows each."""

# Of ImageNet's sRGB images in [0, 1]; what the published weights expect.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class VGG19(FeatureNetwork):
    """The convolutions of VGG-19, under the keys of torchvision's file (``features.N.weight``).

    Layers are named ``relu{block}_{convolution}``, from ``relu1_1`` to ``relu5_4``.
    """

    mean: Tensor
    std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(*_stages())
        self.names = _names()
        self.layers = (RGB, *self.names)
        self.register_buffer("mean", torch.tensor(MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        """See :meth:`FeatureNetwork.forward`."""
        return walk(self.features, self.names, images, (images - self.mean) / self.std, layers)


def _stages() -> Iterator[nn.Module]:
    channels = 3
    for width, count in BLOCKS:
        for _ in range(count):
            yield nn.Conv2d(channels, width, 3, padding=1)
            yield nn.ReLU()
            channels = width
        yield nn.MaxPool2d(2)


def _names() -> dict[str, int]:
    """Place of each rectified output in the chain."""
    names: dict[str, int] = {}
    place = 0
    for block, (_, count) in enumerate(BLOCKS, start=1):
        for convolution in range(1, count + 1):
            names[f"relu{block}_{convolution}"] = place + 1
            place += 2
        place += 1
    return names
