"""AlexNet in torchvision's form (Krizhevsky 2014), the network of the usual LPIPS."""

from collections.abc import Iterator

from torch import nn

from anystyle.perception.vgg import Normalised

NAMES = {"relu1": 1, "relu2": 4, "relu3": 7, "relu4": 9, "relu5": 11}


class AlexNet(Normalised):
    """The convolutions of AlexNet; layers are named ``relu1`` to ``relu5``."""

    def __init__(self) -> None:
        super().__init__(_stages(), NAMES)


def _stages() -> Iterator[nn.Module]:
    yield from (nn.Conv2d(3, 64, 11, stride=4, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    yield from (nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(inplace=True), nn.MaxPool2d(3, stride=2))
    yield from (nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(inplace=True))
    yield from (nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(inplace=True))
    yield from (nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(inplace=True))
