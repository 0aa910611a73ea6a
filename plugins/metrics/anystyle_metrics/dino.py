"""Features of DINO's vision transformers (Caron et al., ICCV 2021), or of the network that stands in for them."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.attention import Block
from anystyle.nn.tokens import normalised
from anystyle.types import Source
from anystyle.vision import networks
from anystyle.vision.features import Frozen, load_frozen
from anystyle.vision.weights import Weights, find, locate, published, read

DEPTH, HEAD, RESOLUTION = 12, 64, 224  # blocks, channels of a head, pixels that position embeddings are stored for
OFFSET = 0.1  # added to the sides of a grid of patches where position embeddings are resampled, as published
SIZES = {"dino_vitb8": (768, 8), "dino_vits16": (384, 16)}  # channels and side of a patch
STAND_IN = "efficientnet_lite0"


class Dino(Frozen):
    """A vision transformer under the publisher's keys."""

    def __init__(self, dim: int, patch_size: int, depth: int = DEPTH) -> None:
        super().__init__()
        grid = RESOLUTION // patch_size
        self.patch_embed = nn.ModuleDict({"proj": nn.Conv2d(3, dim, patch_size, stride=patch_size)})
        self.cls_token = nn.Parameter(torch.zeros(1, 1, dim))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + grid**2, dim))
        # It has no LayerScale, which a gain of 1 is.
        self.blocks = nn.ModuleList(
            Block(dim, dim // HEAD, mlp_ratio=4.0, layer_scale=1.0, eps=1e-6) for _ in range(depth)
        )
        self.norm = nn.LayerNorm(dim, eps=1e-6)

    def keys(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M L C"]:
        """The last block's keys of sRGB images in [0, 1]: of the class token, then of all patches; heads side by side.

        What exceeds a multiple of the patches' side is cut off at the right and below.
        """
        last = self.blocks[-1]
        assert isinstance(last, Block)
        return last.attn.qkv(last.norm1(self._ahead_of_last(images)[0])).chunk(3, dim=-1)[1]

    def maps(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M C h w"]:
        """The normalised tokens of all patches; cut off as for :meth:`keys`."""
        x, grid = self._ahead_of_last(images)
        return self.norm(self.blocks[-1](x))[:, 1:].mT.unflatten(2, grid)

    def _ahead_of_last(self, images: Tensor) -> tuple[Float[Tensor, "M L C"], tuple[int, int]]:
        patches = self.patch_embed["proj"](normalised(images))
        grid = (patches.shape[2], patches.shape[3])
        x = torch.cat([self.cls_token.expand(len(images), -1, -1), patches.flatten(2).mT], dim=1)
        x = x + self._positions(grid)
        for block in self.blocks[:-1]:
            x = block(x)
        return x, grid

    def _positions(self, grid: tuple[int, int]) -> Float[Tensor, "1 L C"]:
        side = round((self.pos_embed.shape[1] - 1) ** 0.5)
        if grid == (side, side):
            return self.pos_embed
        stored = self.pos_embed[:, 1:].mT.unflatten(2, (side, side))
        rows, columns = ((new + OFFSET) / side for new in grid)
        resampled = F.interpolate(stored, scale_factor=(rows, columns), mode="bicubic")
        return torch.cat([self.pos_embed[:, :1], resampled.flatten(2).mT], dim=1)


class StandIn(Frozen):
    """EfficientNet-Lite0's activations less their mean over the image: rectified, they would be alike everywhere.

    Of the layers tried, block 12's similarities rank colour transfer, stylization, a pasted painting and noise in this
    order, and block 5's do so between views.
    """

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load(STAND_IN)

    def keys(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M L 1152"]:
        """Block 12, a token for 32 x 32 pixels of sRGB images in [0, 1]."""
        return self._centered(images, "expand12").flatten(2).mT

    def maps(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 240 h w"]:
        """Block 5, at an eighth of the size."""
        return self._centered(images, "expand5")

    def _centered(self, images: Tensor, layer: str) -> Tensor:
        (features,) = self.network(images, (layer,))
        return features - features.mean((2, 3), keepdim=True)


def load(name: str, choice: Weights = "auto") -> tuple[Dino | StandIn, Source]:
    """A network of :data:`SIZES`, or its stand-in, and its source."""
    file = locate(name, choice)
    if file is None:
        return StandIn(), replace(published(STAND_IN, find(STAND_IN)), network=name, stand_in=STAND_IN)
    network = Dino(*SIZES[name])
    gains = {key: tensor for key, tensor in network.state_dict().items() if ".ls" in key}
    return load_frozen(network, gains | read(file), file), published(name, file)
