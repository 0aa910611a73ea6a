"""Convolutions of AlexNet and VGG as LPIPS and style losses read them, and the bundled texture network.

The texture network is small and was trained only on procedural patterns, to tell stripes from dots, mosaics, hatching
and strokes, in any colours and scale.
Stand-ins need it: features of random weights can be matched without any visible pattern.
"""

from collections.abc import Callable, Iterator, Sequence

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.vision.features import RGB, FeatureNetwork, walk
from anystyle.vision.preprocess import normalised

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Channels of ImageNet's images in [0, 1], by which the published weights expect images to be normalised."""

Blocks = Sequence[tuple[int, int]]
"""Channels and number of convolutions of each block."""
BLOCKS_16: Blocks = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))
BLOCKS_19: Blocks = ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4))
TEXTURE_BLOCKS: Blocks = ((32, 2), (64, 2), (96, 2), (128, 1))


class Chain(FeatureNetwork):
    """Modules in a row, under torchvision's keys (``features.N.weight``), and which of them each layer's output is."""

    mean, std = MEAN, STD

    def __init__(self, stages: Iterator[nn.Module], names: dict[str, int]) -> None:
        super().__init__()
        self.features, self.names, self.layers = nn.Sequential(*stages), names, (RGB, *names)

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        return walk(self.features, self.names, images, normalised(images, self.mean, self.std), layers)


class VGG16(Chain):
    """The convolutions of VGG-16; layers are named ``relu{block}_{convolution}``, up to ``relu5_3``."""

    def __init__(self) -> None:
        super().__init__(stacked(BLOCKS_16, lambda _: [nn.MaxPool2d(2)]), _names(BLOCKS_16))


class VGG19(Chain):
    """The convolutions of VGG-19; layers are named ``relu{block}_{convolution}``, up to ``relu5_4``."""

    def __init__(self) -> None:
        super().__init__(stacked(BLOCKS_19, lambda _: [nn.MaxPool2d(2)]), _names(BLOCKS_19))


class AdainVGG(FeatureNetwork):
    """VGG-19 up to ``relu5_1`` as style transfer by AdaIN knows it, under the keys of its file, ``vgg_normalised.pth``.

    A convolution of colours leads, borders are reflected, poolings round up. Images are normalised as for ImageNet, as
    Stylos does; the file was made for images in [0, 1].
    """

    def __init__(self) -> None:
        super().__init__()
        stages = [nn.Conv2d(3, 3, 1), *stacked(BLOCKS_19, lambda _: [nn.MaxPool2d(2, ceil_mode=True)], _reflecting)]
        ends = [index for index, stage in enumerate(stages) if isinstance(stage, nn.MaxPool2d)]
        self.names = {f"relu{block}_1": start + 3 for block, start in enumerate([0, *ends], start=1)}
        self.layers = (RGB, *self.names)
        for index, stage in enumerate(stages[: self.names["relu5_1"] + 1]):
            self.add_module(str(index), stage)

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        return walk(nn.Sequential(*self.children()), self.names, images, normalised(images, MEAN, STD), layers)


class Texture(Chain):
    """Seven convolutions with reflecting borders and average pooling, 0.32 M parameters.

    Layers are named as VGG's are: ``relu1_1, relu1_2, relu2_1, relu2_2, relu3_1, relu3_2, relu4_1``.
    """

    mean, std = (0.5,) * 3, (0.25,) * 3

    def __init__(self) -> None:
        super().__init__(stacked(TEXTURE_BLOCKS, lambda _: [nn.AvgPool2d(2)], _mirrored), _names(TEXTURE_BLOCKS))


class AlexNet(Chain):
    """The convolutions of AlexNet; layers are named ``relu1`` to ``relu5``."""

    def __init__(self) -> None:
        super().__init__(_alexnet(), {"relu1": 1, "relu2": 4, "relu3": 7, "relu4": 9, "relu5": 11})


def _names(blocks: Blocks) -> dict[str, int]:
    """The index of each rectified output ``relu{block}_{convolution}``: one pooling lies between blocks."""
    names = [f"relu{block}_{number + 1}" for block, (_, count) in enumerate(blocks, start=1) for number in range(count)]
    return {name: 2 * index + int(name[4]) for index, name in enumerate(names)}


def rectified(channels: int, width: int) -> Sequence[nn.Module]:
    """A convolution that keeps the size, and its rectification."""
    return nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(inplace=True)


def stacked(
    blocks: Blocks,
    pooling: Callable[[int], Sequence[nn.Module]],
    convolution: Callable[[int, int], Sequence[nn.Module]] = rectified,
) -> Iterator[nn.Module]:
    """Yield the convolutions of each block with what goes with them, and ahead of every block but the first a pooling.

    Args:
        blocks: Channels and number of convolutions of each.
        pooling: Makes what lies between two blocks, of the first one's channels.
        convolution: Makes a convolution, of the channels that it reads and those that it writes.
    """
    channels = 3
    for block, (width, num_convolutions) in enumerate(blocks):
        if block:
            yield from pooling(channels)
        for _ in range(num_convolutions):
            yield from convolution(channels, width)
            channels = width


def _reflecting(channels: int, width: int) -> Sequence[nn.Module]:
    return nn.ReflectionPad2d(1), nn.Conv2d(channels, width, 3), nn.ReLU()


def _mirrored(channels: int, width: int) -> Sequence[nn.Module]:
    return nn.Conv2d(channels, width, 3, padding=1, padding_mode="reflect"), nn.ReLU()


def _alexnet() -> Iterator[nn.Module]:
    yield from (nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    yield from (nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    for channels, width in ((192, 384), (384, 256), (256, 256)):
        yield from rectified(channels, width)
