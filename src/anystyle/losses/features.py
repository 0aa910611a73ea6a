"""Shared by losses: the images that they compare with, and features of a frozen network."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch
import torch.distributed as dist
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from anystyle.contracts import Loss, StyleEncoder
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.types import Renders, Source, Stylization
from anystyle.vision import networks
from anystyle.vision.eager_backward import eager_backward
from anystyle.vision.feature_cache import digests, identity


def style_images(result: Stylization) -> tuple[Float[Tensor, "B 3 h w"], Bool[Tensor, " B"]] | None:
    """The style images of a batch and which rows have one; rows without are grey. ``None`` if no row has."""
    image, given = result.style.image, result.style.has_image
    if image is None:
        return None
    if given is None:
        return image, torch.ones(image.shape[0], dtype=torch.bool, device=image.device)
    return torch.where(given[:, None, None, None], image, 0.5), given


def mean_where(values: Float[Tensor, " M"], given: Bool[Tensor, " M"]) -> Float[Tensor, ""]:
    """The mean of the values where ``given``; 0 if none is."""
    return torch.where(given, values, 0).sum() / given.sum().clamp_min(1)


Drawn = TypeVar("Drawn", Tensor, list[Any])


def drawn_for_rows(rows: int, draw: Callable[[int], Drawn]) -> Drawn:
    """Random numbers for each row of a batch; of several processes each draws those of all rows and takes its own.

    Row ``i`` of a process is row ``i * world + rank`` of the step, whose seed all processes share.
    """
    if not (dist.is_available() and dist.is_initialized()):
        return draw(rows)
    return draw(rows * dist.get_world_size())[dist.get_rank() :: dist.get_world_size()]


Reference = Literal["photograph", "render"]


def unstyled_renders(result: Stylization) -> Renders:
    """The renders of the unstyled scene, which ``reference=render`` compares with."""
    if result.unstyled is None:
        raise UserError("reference=render compares with renders of the unstyled scene, and there are none")
    return result.unstyled


def resized(images: Float[Tensor, "M 3 H W"], side: int | None, mode: str, *, antialias: bool = False) -> Tensor:
    """Images resized to a square; ``None`` leaves them as they are."""
    if side is None or images.shape[-2:] == (side, side):
        return images
    return F.interpolate(images, size=(side, side), mode=mode, align_corners=False, antialias=antialias)


_KEPT: MutableMapping[Tensor, tuple[object, LRUCache[tuple[object, ...], list[Tensor]]]] = WeakIdKeyDictionary()
_MOST = 64
"""How many results are kept for one tensor; those of a network that learns are never asked for again."""


@torch.no_grad()
def features_to_compare(
    images: Float[Tensor, "*batch 3 H W"], key: tuple[object, ...], compute: Callable[[Tensor], list[Tensor]]
) -> list[Tensor]:
    """What ``compute`` gives for images ``M 3 H W``, kept as long as they are: a scene has the same in all its steps.

    The ``key`` is everything else that the result depends on: network, layers, size. Whether images have changed is
    known by their values on a CPU, and elsewhere, where these would be waited for, by PyTorch's version counter.
    """
    rows = images.flatten(0, -4)
    values = digests(rows) if images.device.type == "cpu" else 0 if images.is_inference() else images._version
    state = torch.is_inference_mode_enabled(), values
    if images not in _KEPT or _KEPT[images][0] != state:
        _KEPT[images] = state, LRUCache(_MOST)
    return _KEPT[images][1].get(key, lambda: [features.detach() for features in compute(rows)])


def reference_embeddings(
    result: Stylization, reference: Reference, encoder: StyleEncoder, size: int | None
) -> Float[Tensor, "M D"]:
    """The style encoder's embeddings of the unstyled images, resized to a square, without gradients."""
    images = result.views.images if reference == "photograph" else unstyled_renders(result).color
    key = (identity(encoder), size)
    return features_to_compare(images, key, lambda each: [encoder.embed_images(resized(each, size, "bicubic"))])[0]


FeatureFn = Callable[[], list[Float[Tensor, "M _ _ _"]]]
"""Gives features of images when they are needed: a style without an image needs none."""


class FeatureLoss(Loss):
    """A loss on features of some layers of a network; constructors of subclasses name the options.

    Args:
        network: A network of :func:`anystyle.vision.networks.load`, or several to choose from; see
            :func:`anystyle.vision.networks.choose`.
        layers: Whose features.
        size: Side of the square that images are first resized to; ``None`` leaves them as they are.
        weight: In the objective.
    """

    def __init__(self, network: str, layers: Sequence[str], size: int | None, weight: float) -> None:
        super().__init__()
        self._chosen = networks.choose(network, layers)
        self.network, self.layers = self._chosen.network, self._chosen.layers
        self.size = size
        self.weight = weight

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"network": "texture", "layers": ("relu1_1", "relu2_1"), "size": 48}

    @property
    def source(self) -> Source:
        """The network of the features, and what it stands in for."""
        return self._chosen.source

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        def value(images: Tensor) -> Tensor:
            return self.compare(result, images, lambda: self.features(images))

        return eager_backward(value, result.renders.color.flatten(0, 1))

    @abstractmethod
    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        """The loss of images in place of the renders of ``result``; ``features`` gives theirs, of ``layers``."""

    def features(
        self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str] | None = None
    ) -> list[Float[Tensor, "M _ _ _"]]:
        """The features of sRGB images, resized to a square without keeping their aspect, as published."""
        return self.network(resized(images, self.size, "bilinear", antialias=True), layers or self.layers)

    def targets(self, images: Float[Tensor, "*batch 3 H W"]) -> list[Float[Tensor, "M _ _ _"]]:
        """Features to compare with, without gradients; see :func:`features_to_compare`."""
        return features_to_compare(images, (identity(self.network), *self.layers, self.size), self.features)


class StatisticsLoss(FeatureLoss):
    """Distance of statistics of stylized views and of the style image, the mean over views that have one.

    A layer's distance is the sum over the K parts of the mean squared difference of their D numbers; layers are added.

    Args:
        size: Side that renders and style images are resized to; ``None`` keeps each as it is.
        relative: Divide each view's distance by that of its photograph and take the square root, then average over
            the layers: 1 means as far from the style as the photograph, 0 means a match. Large differences of colour
            then do not outweigh the small ones of patterns.
    """

    def __init__(self, network: str, layers: Sequence[str], size: int | None, relative: bool, weight: float) -> None:
        super().__init__(network, layers, size, weight)
        self.relative = relative
        self.reduction = "mean"

    @abstractmethod
    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        """The statistics of one layer's features: K parts of D numbers each."""

    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        styles = style_images(result)
        if styles is None:
            return images.new_zeros(())
        style, given = styles
        num_views = result.renders.color.shape[1]
        with torch.no_grad():
            targets = [self.statistics(features).repeat_interleave(num_views, 0) for features in self.targets(style)]
            photographs = self.targets(result.views.images) if self.relative else []
            starts = [self.statistics(features) for features in photographs]
        total = images.new_zeros(())
        for layer, of_layer in enumerate(features()):
            distance = self._distance(self.statistics(of_layer), targets[layer])
            if self.relative:
                distance = (distance / self._distance(starts[layer], targets[layer]).clamp_min(1e-12) + 1e-3).sqrt()
            total = total + mean_where(distance, given.repeat_interleave(num_views))
        return total / len(self.layers) if self.relative else total

    def _distance(self, first: Float[Tensor, "M K D"], second: Float[Tensor, "M K D"]) -> Float[Tensor, " M"]:
        squares = (first - second).square()
        return (squares.mean(-1) if self.reduction == "mean" else squares.sum(-1)).sum(-1)


def objective(terms: Mapping[str, Loss], result: Stylization) -> tuple[Float[Tensor, ""], dict[str, Tensor]]:
    """The weighted sum of some terms, and the value of each without gradients.

    Terms that read one network at one size share one pass of it over the renders.
    """
    values = {name: term(result) for name, term in terms.items() if not isinstance(term, FeatureLoss)}
    total = result.renders.color.new_zeros(()) + sum(terms[name].weight * value for name, value in values.items())
    alike: dict[tuple[Source, int | None], dict[str, FeatureLoss]] = {}
    for name, term in terms.items():
        if isinstance(term, FeatureLoss):
            alike.setdefault((term.source, term.size), {})[name] = term
    for group in alike.values():
        total = total + eager_backward(partial(_together, group, result, values), result.renders.color.flatten(0, 1))
    return total, {name: values[name].detach() for name in terms}


def _together(
    group: Mapping[str, FeatureLoss], result: Stylization, values: dict[str, Tensor], images: Float[Tensor, "M 3 H W"]
) -> Float[Tensor, ""]:
    first, layers = next(iter(group.values())), list(dict.fromkeys(chain(*(term.layers for term in group.values()))))
    by_layer = cache(lambda: dict(zip(layers, first.features(images, layers), strict=True)))
    total = images.new_zeros(())
    for name, term in group.items():
        value = term.compare(result, images, lambda term=term: [by_layer()[layer] for layer in term.layers])
        values[name], total = value, total + term.weight * value
    return total
