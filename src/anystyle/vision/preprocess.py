"""Preparing images for networks of metrics: resizing, rounding to 8 bits, removing colour."""

from collections.abc import Sequence

import kornia
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor


def eight_bit(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
    """Images in [0, 1] as a file of 8 bits holds them."""
    return (images.clamp(0, 1) * 255).round() / 255


def resized(
    images: Float[Tensor, "M 3 H W"], size: int, *, rounded: bool = False, mode: str = "bilinear"
) -> Float[Tensor, "M 3 h w"]:
    """Images in [0, 1] whose shorter side is ``size``; with antialiasing, the longer side rounded down.

    With ``rounded`` they have 8 bits before and after, as Pillow's do: the published scripts resize files.
    """
    height, width = images.shape[-2:]
    other = int(size * max(height, width) / min(height, width))
    shape = (size, other) if height <= width else (other, size)
    if rounded:
        return as_pillow(images, shape)
    return F.interpolate(images, size=shape, mode=mode, antialias=True) if shape != (height, width) else images


def as_pillow(
    images: Float[Tensor, "M 3 H W"], shape: tuple[int, int], kernel: Image.Resampling = Image.Resampling.BILINEAR
) -> Float[Tensor, "M 3 h w"]:
    """Images resized by Pillow as in the published scripts: with antialiasing, 8 bits before and after."""
    planes = images.clamp(0, 1).mul_(255).round_().byte().cpu().flatten(0, 1).contiguous().numpy()
    size = shape[1], shape[0]
    resized = np.stack([np.asarray(Image.fromarray(plane).resize(size, kernel)) for plane in planes])
    return torch.from_numpy(resized).to(images.device).unflatten(0, images.shape[:2]).to(images.dtype) / 255


def normalised(
    images: Float[Tensor, "*batch 3 H W"], mean: Sequence[float], std: Sequence[float]
) -> Float[Tensor, "*batch 3 H W"]:
    """Images less the mean of each channel, over its deviation."""
    return (images - images.new_tensor(mean)[:, None, None]) / images.new_tensor(std)[:, None, None]


def shrunk(images: Float[Tensor, "M 3 H W"], longest: int | None) -> Float[Tensor, "M 3 h w"]:
    """Images whose longest side is at most ``longest``, their shape kept."""
    height, width = images.shape[-2:]
    if longest is None or max(height, width) <= longest:
        return images
    factor = longest / max(height, width)
    size = (max(1, round(height * factor)), max(1, round(width * factor)))
    return F.interpolate(images, size=size, mode="bilinear", align_corners=False, antialias=True)


def middle_square(images: Float[Tensor, "*batch H W"]) -> Float[Tensor, "*batch S S"]:
    """The largest square in the middle of images."""
    height, width = images.shape[-2:]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    return images[..., top : top + side, left : left + side]


def gray(images: Float[Tensor, "M 3 H W"], *, rounded: bool) -> Float[Tensor, "M 3 H W"]:
    """Luma (ITU-R BT.601) of sRGB in [0, 1] in all three channels; ``rounded`` to 8 bits as Pillow does."""
    if rounded:
        parts = (images * 255).round() * images.new_tensor([19595.0, 38470.0, 7471.0]).view(3, 1, 1)
        channel = ((parts.sum(1, keepdim=True) + 0x8000) / 0x10000).floor() / 255
    else:
        channel = kornia.color.rgb_to_grayscale(images)
    return channel.expand(-1, 3, -1, -1)
