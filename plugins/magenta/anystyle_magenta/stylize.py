"""Stylizing pictures of any size: each on its own, or the views of a scene as one."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle_magenta.transfer import DIVISOR, StyleTransfer

MIN_SIDE = 2 * DIVISOR


def stylize_images(
    network: StyleTransfer,
    images: Float[Tensor, "B V C H W"],
    style: Float[Tensor, "B D"],
    *,
    working_size: int | None = None,
    joint: bool = False,
    chunk: int = 8,
) -> Float[Tensor, "B V C H W"]:
    """Stylize pictures; differentiable in pictures and style.

    Picture by picture it is the 2D teacher: what stylizing renders or photographs one by one gives.

    Args:
        network: See :func:`anystyle_magenta.pretrained.load_transfer`.
        images: sRGB in [0, 1].
        style: A vector a row.
        working_size: The shorter side in pixels that the network sees. Strokes have a fixed width in
            its pixels, so that a smaller size has broader ones. ``None``: as the images are.
        joint: Whether the views of a row share the statistics of the normalisations, as parts of one picture do.
        chunk: Views convolved at a time, which changes memory alone.

    Returns:
        sRGB in [0, 1], as large as the images.
    """
    height, width = images.shape[-2:]
    pictures = _resized(images, working_shape((height, width), working_size))
    if joint:
        stylized = network(pictures, style, chunk)
    else:
        rows = pictures.flatten(0, 1)[:, None].split(chunk)
        styles = style.repeat_interleave(images.shape[1], dim=0).split(chunk)
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
    return rows.clamp(0, 1).unflatten(0, images.shape[:2])
