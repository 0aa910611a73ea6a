"""A small bundled network of textures, trained on procedural patterns alone.

Style losses and stand-ins for published networks need features that respond to texture. Random features can be matched
without any visible pattern; these were trained to tell stripes from dots, mosaics, hatching and strokes at several
scales, in any colours (``anystyle train experiment=tiny_perceptual``).
"""

from collections.abc import Iterator, Sequence

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception.features import RGB, FeatureNetwork, relu_names, walk

BLOCKS = ((32, 2), (64, 2), (96, 2), (128, 1))
"""Channels and number of convolutions of each block; an average pooling lies between blocks."""


class Texture(FeatureNetwork):
    """Seven convolutions with reflecting borders and average pooling, 0.32 M parameters.

    Layers are named as VGG's are: ``relu1_1, relu1_2, relu2_1, relu2_2, relu3_1, relu3_2, relu4_1``.
    """

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(*_stages())
        self.names = relu_names(BLOCKS)
        self.layers = (RGB, *self.names)

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        return walk(self.features, self.names, images, centred(images), layers)


def centred(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
    """Images in [0, 1] scaled to mean about 0 and deviation about 1, the input of the first convolution."""
    return (images - 0.5) * 4


def _stages() -> Iterator[nn.Module]:
    channels = 3
    for block, (width, num_convolutions) in enumerate(BLOCKS):
        if block:
            yield nn.AvgPool2d(2)
        for _ in range(num_convolutions):
            yield nn.Conv2d(channels, width, 3, padding=1, padding_mode="reflect")
            yield nn.ReLU()
            channels = width
