"""Preparing images for the evaluation's networks, as the published scripts did and as they should."""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor


def eight_bit(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
    """Images in [0, 1] as a file of 8 bits holds them."""
    return (images.clamp(0, 1) * 255).round() / 255


def resized(images: Float[Tensor, "M 3 H W"], size: int, *, rounded: bool) -> Float[Tensor, "M 3 h w"]:
    """Images whose shorter side is ``size``; bilinear with antialiasing, the longer side rounded down.

    Args:
        images: In [0, 1].
        size: In pixels.
        rounded: Whether images have 8 bits before and after, as Pillow's do: the published scripts resize files.
    """
    height, width = images.shape[-2:]
    short, long = min(height, width), max(height, width)
    other = int(size * long / short)
    shape = (size, other) if height <= width else (other, size)
    if rounded:
        return as_pillow(images, shape)
    if shape == (height, width):
        return images
    return F.interpolate(images, size=shape, mode="bilinear", align_corners=False, antialias=True)


def as_pillow(images: Float[Tensor, "M 3 H W"], shape: tuple[int, int]) -> Float[Tensor, "M 3 h w"]:
    """Images resized by Pillow, as the published scripts do: bilinear with antialiasing, 8 bits before and after.

    Args:
        images: In [0, 1].
        shape: Height and width to resize to.
    """
    eight = (images.clamp(0, 1) * 255).round().byte().cpu().permute(0, 2, 3, 1).contiguous().numpy()
    height, width = shape
    found = [np.asarray(Image.fromarray(one).resize((width, height), Image.Resampling.BILINEAR)) for one in eight]
    back = torch.from_numpy(np.stack(found)).to(images.device).permute(0, 3, 1, 2)
    return back.to(images.dtype).contiguous() / 255


def gray(images: Float[Tensor, "M 3 H W"], *, rounded: bool) -> Float[Tensor, "M 3 H W"]:
    """Luma in all three channels, with the weights of ITU-R 601-2 as Pillow's.

    Args:
        images: sRGB in [0, 1].
        rounded: Whether the result has 8 bits, computed as Pillow does.
    """
    if rounded:
        parts = (images * 255).round() * images.new_tensor([19595.0, 38470.0, 7471.0]).view(3, 1, 1)
        luma = ((parts.sum(1, keepdim=True) + 0x8000) / 0x10000).floor() / 255
    else:
        luma = (images * images.new_tensor([0.299, 0.587, 0.114]).view(3, 1, 1)).sum(1, keepdim=True)
    return luma.expand(-1, 3, -1, -1)


def finite(images: Float[Tensor, "*batch"], what: str) -> None:
    """Refuse images that hold no numbers.

    Raises:
        ValueError: A value is NaN or infinite.
    """
    bad = int((~torch.isfinite(images)).sum())
    if bad:
        raise ValueError(f"{what} hold {bad} values that are NaN or infinite; a figure needs numbers in [0, 1]")
