"""Networks of ST-LPIPS (Ghildyal and Liu, ECCV 2022, arXiv:2207.13686), which hardly sees that an image was shifted.

They are VGG-16 and AlexNet with a blur ahead of every subsampling, trained from scratch on people's judgements.
"""

from collections.abc import Iterator, Mapping

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.vision.vgg import BLOCKS_16, Chain, rectified, stacked


class Blur(nn.Module):
    """Every second pixel of features blurred by (1, 2, 1) along both axes; two pixels are reflected at every border."""

    filt: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("filt", torch.zeros(channels, 1, 3, 3))

    def forward(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M C _ _"]:
        if min(features.shape[-2:]) < 3:
            raise UserError("images are too small for ST-LPIPS, which needs 21 x 21 pixels; enlarge them")
        return F.conv2d(F.pad(features, (2, 2, 2, 2), mode="reflect"), self.filt, stride=2, groups=len(self.filt))


class ShiftTolerantVGG16(Chain):
    """VGG-16; layers are named as those of :class:`~anystyle.vision.vgg.VGG16` that LPIPS compares."""

    def __init__(self) -> None:
        stages = stacked(BLOCKS_16, lambda channels: [nn.MaxPool2d(2, stride=1), Blur(channels)])
        super().__init__(stages, {"relu1_2": 3, "relu2_2": 9, "relu3_3": 17, "relu4_3": 25, "relu5_3": 33})


class ShiftTolerantAlexNet(Chain):
    """AlexNet; layers are named ``relu1`` to ``relu5``."""

    def __init__(self) -> None:
        super().__init__(_alexnet(), {"relu1": 2, "relu2": 6, "relu3": 10, "relu4": 12, "relu5": 14})


def trunk(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The convolutions and blurs of a published file, under the keys of the networks here."""
    return {f"features.{key.split('.', 2)[2]}": tensor for key, tensor in state.items() if key.startswith("net.slice")}


def _alexnet() -> Iterator[nn.Module]:
    yield from (nn.Conv2d(3, 64, 11, padding=2), Blur(64), nn.ReLU(inplace=True))
    yield from (nn.MaxPool2d(3, stride=1), Blur(64), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(inplace=True))
    yield from (nn.MaxPool2d(3, stride=1), Blur(192))
    for channels, width in ((192, 384), (384, 256), (256, 256)):
        yield from rectified(channels, width)
