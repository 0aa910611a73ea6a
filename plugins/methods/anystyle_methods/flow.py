"""Which way a picture flows: the structure tensor, and the directions along which it changes least."""

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d, spatial_gradient
from torch import Tensor


def blur(images: Float[Tensor, "V C H W"], sigma: float) -> Float[Tensor, "V C H W"]:
    """Gaussian blur with a standard deviation in pixels."""
    side = 2 * max(1, min(round(3 * sigma), min(images.shape[-2:]) - 1)) + 1
    return gaussian_blur2d(images, (side, side), (sigma, sigma), border_type="replicate")


def structure_tensor(images: Float[Tensor, "V 3 H W"], inner: float, outer: float) -> Float[Tensor, "V 3 H W"]:
    """``Ix², Ix Iy, Iy²`` of the luminance blurred by ``inner`` pixels, averaged over ``outer``; mean trace 1."""
    x, y = spatial_gradient(blur(images.mean(1, keepdim=True), inner), mode="diff")[:, 0].unbind(1)  # V H W
    tensor = blur(torch.stack([x * x, x * y, y * y], dim=1), outer)
    return tensor / (tensor[:, 0] + tensor[:, 2]).mean().clamp_min(1e-12)


def flow(tensor: Float[Tensor, "V 3 H W"]) -> tuple[Float[Tensor, "V 2 H W"], Float[Tensor, "V H W"]]:
    """Unit vectors (x, y) along which the image changes least, and how clearly so, in [0, 1]."""
    xx, xy, yy = tensor.unbind(1)
    angle = 0.5 * torch.atan2(2 * xy, xx - yy)  # of the gradient
    clarity = ((xx - yy).square() + 4 * xy.square()).sqrt() / (xx + yy).clamp_min(1e-12)
    return torch.stack([-angle.sin(), angle.cos()], dim=1), clarity
