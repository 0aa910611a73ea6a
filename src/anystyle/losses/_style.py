"""The images that a stylized view is compared with, and means over the views that have one."""

from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.types import Stylization


def style_images(result: Stylization) -> tuple[Float[Tensor, "B 3 h w"], Bool[Tensor, " B"]] | None:
    """The style images of a batch and which rows hold one; rows without are grey. ``None`` if none does."""
    image, given = result.style.image, result.style.has_image
    if image is None:
        return None
    if given is None:
        return image, torch.ones(image.shape[0], dtype=torch.bool, device=image.device)
    return torch.where(given[:, None, None, None], image, 0.5), given


def mean_where(values: Float[Tensor, " M"], given: Bool[Tensor, " M"]) -> Float[Tensor, ""]:
    """The mean of the values that are given; 0 where none is."""
    return torch.where(given, values, 0).sum() / given.sum().clamp_min(1)


Reference = Literal["photograph", "render"]


def reference_images(result: Stylization, reference: Reference) -> Float[Tensor, "B V 3 H W"]:
    """The images before the change of style.

    Raises:
        ValueError: The unstyled render is asked for, and there is none.
    """
    if reference == "photograph":
        return result.views.images
    if result.unstyled is None:
        raise ValueError("reference=render compares with the unstyled scene, of which this training makes no render")
    return result.unstyled.color
