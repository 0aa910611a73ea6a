"""AlexNet's and VGG's convolutions, as LPIPS and style losses read them."""

from collections.abc import Iterator, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception.features import RGB, FeatureNetwork, relu_names, walk

# Channels and convolutions of each block; a maximum pooling follows each.
BLOCKS_16 = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))
BLOCKS_19 = ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4))

# Of ImageNet's sRGB images in [0, 1]; what the published weights expect.
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class Normalised(FeatureNetwork):
    """A chain of modules that reads images normalised as ImageNet's, under torchvision's keys (``features.N.weight``).

    Args:
        stages: The chain.
        names: For each layer the index of the module whose output it is.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, stages: Iterator[nn.Module], names: Mapping[str, int]) -> None:
        super().__init__()
        self.features = nn.Sequential(*stages)
        self.names = dict(names)
        self.layers = (RGB, *self.names)
        self.register_buffer("mean", torch.tensor(MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        return walk(self.features, self.names, images, (images - self.mean) / self.std, layers)


class VGG16(Normalised):
    """The convolutions of VGG-16; layers are named ``relu{block}_{convolution}``, up to ``relu5_3``."""

    def __init__(self) -> None:
        super().__init__(_vgg_stages(BLOCKS_16), relu_names(BLOCKS_16))


class VGG19(Normalised):
    """The convolutions of VGG-19; layers are named ``relu{block}_{convolution}``, up to ``relu5_4``."""

    def __init__(self) -> None:
        super().__init__(_vgg_stages(BLOCKS_19), relu_names(BLOCKS_19))


def _vgg_stages(blocks: Sequence[tuple[int, int]]) -> Iterator[nn.Module]:
    channels = 3
    for width, num_convolutions in blocks:
        for _ in range(num_convolutions):
            yield nn.Conv2d(channels, width, 3, padding=1)
            yield nn.ReLU(inplace=True)
            channels = width
        yield nn.MaxPool2d(2)


ALEXNET_LAYERS = {"relu1": 1, "relu2": 4, "relu3": 7, "relu4": 9, "relu5": 11}


class AlexNet(Normalised):
    """The convolutions of AlexNet; layers are named ``relu1`` to ``relu5``."""

    def __init__(self) -> None:
        super().__init__(_alexnet_stages(), ALEXNET_LAYERS)


def _alexnet_stages() -> Iterator[nn.Module]:
    yield from (nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    yield from (nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    yield from (nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(inplace=True))
    yield from (nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(inplace=True))
    yield from (nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(inplace=True))
