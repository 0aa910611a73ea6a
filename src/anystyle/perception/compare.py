"""How a stylized scene is compared with its style image: what the style losses have in common."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.perception.features import FeatureNetwork
from anystyle.types import Stylization

Describe = Callable[[str, Tensor], Tensor]
"""From a layer's name and its features ``M C h w`` to a summary ``M K D``: K parts of D numbers each."""


def squash(images: Float[Tensor, "M 3 H W"], size: int | None) -> Float[Tensor, "M 3 h w"]:
    """Images resized to a square, their aspect not kept, as published; ``None`` leaves them as they are."""
    if size is None or images.shape[-2:] == (size, size):
        return images
    return F.interpolate(images, size=(size, size), mode="bilinear", align_corners=False, antialias=True)


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


def style_distance(
    result: Stylization,
    *,
    network: FeatureNetwork,
    layers: Sequence[str],
    size: int | None,
    describe: Describe,
    relative: bool,
) -> Float[Tensor, ""]:
    """Distance of the summaries of stylized views and of the style image, the mean over views that have one.

    A layer's distance is the sum over the K parts of the mean squared difference of their D numbers; layers are added.

    Args:
        result: What to judge.
        network: Whose features are summarised.
        layers: Which of them.
        size: Side of the square that all images are squashed to before; ``None`` for none.
        describe: The summary.
        relative: Divide each view's distance by that of its photograph and take the square root, then average over
            the layers: 1 means as far from the style as the photograph, 0 means there. Colour, which is quickly
            matched, then no longer drowns the small differences that make a pattern.
    """
    styles = style_images(result)
    if styles is None:
        return result.renders.color.new_zeros(())
    image, given = styles
    num_views = result.renders.color.shape[1]

    def summaries(images: Tensor) -> list[Tensor]:
        return [describe(*pair) for pair in zip(layers, network(squash(images, size), layers), strict=True)]

    with torch.no_grad():
        targets = [target.repeat_interleave(num_views, 0) for target in summaries(image)]
        starts = summaries(result.views.images.flatten(0, 1)) if relative else []
    total = result.renders.color.new_zeros(())
    for place, found in enumerate(summaries(result.renders.color.flatten(0, 1))):
        distance = _distance(found, targets[place])
        if relative:
            distance = (distance / _distance(starts[place], targets[place]).clamp_min(1e-12) + 1e-3).sqrt()
        total = total + mean_where(distance, given.repeat_interleave(num_views))
    return total / len(layers) if relative else total


def _distance(first: Tensor, second: Tensor) -> Tensor:
    return (first - second).square().mean(-1).sum(-1)
