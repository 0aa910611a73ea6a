"""Stylizing pictures of any size, and colours of pixels, through the style transfer network."""

from copy import copy
from pathlib import Path
from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.errors import UserError
from anystyle.geometry.harmonics import CONSTANT
from anystyle.ranges import Range
from anystyle.types import Tokens
from anystyle_magenta.networks import DIVISOR, STYLE_DIM, StyleTransfer
from anystyle_magenta.pretrained import load_transfer

MIN_SIDE = 2 * DIVISOR
FINEST = 0.75
"""Size of the last painting relative to the views. At their own size it costs 1.8 times as much, and Gaussians lose
strokes that are finer."""
MAX_SCALE_UP = 2
"""No painting is larger than the views by more than this."""
MARKS, USUAL = {5: 0.70, 4: 0.66, 25: 0.35}, -0.24
"""Weights of numbers of a style, whose sum is how many octaves broader the marks of a painting are than a constant, and
that sum for the usual painting. By least squares over 110 paintings: the mean octave of the variance of lightness, of
differences of blurs by 0.5 to 8 pixels at 256; the share of its variance in paintings left out is 0.59."""
STEEPNESS, MOST = 2.0, 0.5
"""Octaves that strokes are broader by for each octave of the marks, and the most: with half as broad strokes paintings
are found less often, and twice as broad ones hide the scene."""


def stroke_scales(styles: Float[Tensor, "B D"]) -> list[float]:
    """How much broader than usual the strokes of styles are, from 0.7 to 1.4.

    They are read back, all at once, for they decide how large the pictures are that the network sees.
    """
    marks = sum(weight * styles[:, number] for number, weight in MARKS.items())
    assert isinstance(marks, Tensor)
    return [2 ** max(-MOST, min(STEEPNESS * (each - USUAL), MOST)) for each in marks.tolist()]


def stylize_images(
    network: StyleTransfer,
    images: Float[Tensor, "B V C H W"],
    style: Float[Tensor, "B D"],
    *,
    working_size: int | None = None,
    joint: bool = False,
) -> Float[Tensor, "B V C H W"]:
    """Stylize pictures; differentiable in pictures and style.

    Picture by picture it is the 2D teacher: what stylizing renders or photographs one by one gives.

    Args:
        network: See :func:`anystyle_magenta.pretrained.load_transfer`.
        images: sRGB in [0, 1].
        style: One vector per row.
        working_size: The shorter side in pixels that the network sees. Strokes have a fixed width in
            its pixels, so that a smaller size has broader ones. ``None``: as the images are.
        joint: Whether the views of a row share the statistics of the normalisations, as parts of one picture do.

    Returns:
        sRGB in [0, 1], as large as the images.
    """
    height, width = images.shape[-2:]
    pictures = _resized(images, working_shape((height, width), working_size))
    if joint:
        stylized = network(pictures, style)
    else:
        rows = pictures.flatten(0, 1)[:, None].split(1)
        styles = style.repeat_interleave(images.shape[1], dim=0).split(1)
        parts = [network(row, vectors) for row, vectors in zip(rows, styles, strict=True)]
        stylized = torch.cat(parts).view(pictures.shape)
    return _resized(stylized, (height, width))


def working_shape(size: tuple[int, int], working_size: int | None) -> tuple[int, int]:
    """Height and width, multiples of 4, at which the network sees images of a size; the aspect is kept."""
    scale = 1.0 if working_size is None else working_size / min(size)
    height, width = (max(MIN_SIDE, round(side * scale / DIVISOR) * DIVISOR) for side in size)
    return height, width


def _resized(images: Float[Tensor, "B V C H W"], size: tuple[int, int]) -> Float[Tensor, "B V C h w"]:
    if (images.shape[-2], images.shape[-1]) == size:
        return images
    rows = F.interpolate(images.flatten(0, 1), size=size, mode="bicubic", antialias=True, align_corners=False)
    return rows.clamp_(0, 1).unflatten(0, images.shape[:2])


class MagentaInjector(Injector):
    """Stylize the pictures that tokens are: ``x + gate * (stylized(x, z) - x)``.

    Tokens are the colours of the pixels of all views, as harmonics of degree 0. The views are stylized together: the
    normalisations of the network take their statistics over all of them, so that the order of views does not matter
    and a colour does not change with the view it is seen in.

    Args:
        dim: Channels at the site; 3 with published weights.
        style_dim: Dimensions of the style embedding; 100 with published weights.
        working_size: The shorter side in pixels that the network sees the views at; strokes are broader at smaller
            sizes.
        coarse_to_fine: Whether larger views are painted again on top at twice the size, and so on up to their own:
            broad strokes with sharp edges.
        own_strokes: Whether strokes are as broad as a style asks for by its numbers, :func:`stroke_scales` times the
            usual: what the network makes of plain parts of the views then is not the same in every style.
        gate: What ``gate`` starts as: 0 is the identity, from which a branch learns; 1 stylizes without any learning.
        pretrained: Whether the network starts from Magenta's weights (``anystyle weights list magenta_transform``).
            One that starts from scratch takes any sites and any embedding.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        working_size: Annotated[int, Range(ge=MIN_SIDE)] = 224,
        coarse_to_fine: bool = True,
        own_strokes: bool = False,
        gate: float = 0.0,
        pretrained: bool = True,
    ) -> None:
        super().__init__()
        if pretrained and (dim, style_dim) != (3, STYLE_DIM):
            raise UserError(
                f"injector=magenta stylizes colours, 3 channels, by the {STYLE_DIM} numbers of style_encoder=magenta; "
                f"the site has {dim} channels and the style {style_dim} numbers; choose placement=color, or "
                "injector.pretrained=false"
            )
        self.working_size, self.coarse_to_fine, self.scale = working_size, coarse_to_fine, 1.0
        self.own_strokes = own_strokes
        self.network = StyleTransfer(channels=dim, style_dim=style_dim)
        self.gate = nn.Parameter(torch.tensor(float(gate)))
        if pretrained:
            self.sources = (load_transfer(self.network),)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"pretrained": False, "working_size": 16}

    def sizes(self, grid: tuple[int, int]) -> list[int]:
        """Shorter sides that views of a grid are painted at, each on top of the one before."""
        finest, largest = round(FINEST * min(grid)), MAX_SCALE_UP * max(min(grid), self.working_size)
        sizes = [max(MIN_SIDE, min(round(self.working_size / self.scale), largest))]
        while self.coarse_to_fine and sizes[-1] < 0.8 * finest:
            sizes.append(min(2 * sizes[-1], finest))
        return sizes

    def at_scale(self, scale: float) -> "MagentaInjector":
        other = copy(self)
        other.scale = self.scale * scale
        return other

    def _painted(
        self, patches: Float[Tensor, "B V p C"], style: Float[Tensor, "B D"], grid: tuple[int, int]
    ) -> Float[Tensor, "B V C H W"]:
        """Views in styles of strokes of one width."""
        # As rgb_from_constant, for any number of channels.
        images = (patches.to(style) * CONSTANT).add_(0.5).clamp_(0, 1).mT.unflatten(-1, grid)
        for size in self.sizes((images.shape[-2], images.shape[-1])):
            images = stylize_images(self.network, images, style, working_size=size, joint=True)
        return images

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Stylize the patches; special tokens stay."""
        patches = tokens.patches  # B V (H W) C
        style = style.to(self.gate.dtype)
        if self.own_strokes:
            painters = map(self.at_scale, stroke_scales(style))
            rows = zip(painters, patches.split(1), style.split(1), strict=True)
            stylized = torch.cat([painter._painted(part, one, tokens.grid) for painter, part, one in rows])
        else:
            stylized = self._painted(patches, style, tokens.grid)
        colors = stylized.sub_(0.5).div_(CONSTANT).flatten(-2).mT.to(patches.dtype)  # as constant_from_rgb
        return tokens.with_patches(torch.lerp(patches, colors, self.gate.to(patches.dtype)))
