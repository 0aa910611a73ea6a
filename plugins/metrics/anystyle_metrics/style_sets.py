"""Scores of results among a set of styles: likeness to their own, less that of hubs, and how far styles are apart."""

import warnings
import zlib
from abc import abstractmethod
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics.base import stacked, with_style_images
from anystyle.types import Comparison

NEAREST = 10
"""Neighbours whose mean likeness is subtracted, or as many as there are, as in both papers."""


def csls(similar: Float[Tensor, "N G"]) -> Float[Tensor, "N G"]:
    """Likeness of results and styles, ``2 s`` less the mean of each one's :data:`NEAREST` on the other side.

    Cross-domain similarity local scaling (Conneau et al., ICLR 2018): a style that is like all results, a hub, is no
    longer taken for the style of any.
    """
    near = (similar.topk(min(NEAREST, similar.shape[dim]), dim).values.mean(dim, keepdim=True) for dim in (0, 1))
    return 2 * similar - sum(near)


def gaps(similar: Float[Tensor, "G G"]) -> Float[Tensor, " G"]:
    """How much more a half of each style is like the other half than like a half of any other style; ``nan`` of one.

    ``similar`` is the likeness of first halves to second ones.
    """
    similar = (similar + similar.mT) / 2
    nearest = similar.clone().fill_diagonal_(-torch.inf).amax(1)
    return (similar.diagonal() - nearest).where(nearest > -torch.inf, torch.nan)


def named(*scores: str) -> dict[str, str]:
    """The three scores of each way of looking, as :attr:`~anystyle.contracts.Metric.better` lists them."""
    return {score + end: "higher" for score in scores for end in ("", "_csls", "_gap")}


class StyleSet(Metric):
    """Likeness of results to their own style among all styles, by vectors of images, looked at in one or more ways.

    For each way of looking :attr:`better` names three scores: the likeness (``value``); the same after :func:`csls`,
    between the results of a scene and all style images, ``nan`` for a result or style that is alone; and the
    discrimination gap (:func:`gaps`) of its style, above 0 where the network tells it from all others. Where it does
    not, a warning says of how many styles. A row has the mean vector of its views.
    """

    full_state_update = False
    takes = ("preds", "style", "scenes")
    rows: list[Tensor]
    styles: list[Tensor]
    scenes: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        for state in ("rows", "styles", "scenes"):
            self.add_state(state, [], dist_reduce_fx="cat")

    @abstractmethod
    def vectors(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M L D"]:
        """Vectors of sRGB images in [0, 1], for each way of looking."""

    @abstractmethod
    def similar(self, rows: Float[Tensor, "N D"], styles: Float[Tensor, "G D"]) -> Float[Tensor, "N G"]:
        """The likeness of the results of one scene, or of halves of styles, to all styles."""

    @abstractmethod
    def value(self, similar: Float[Tensor, "N G"], own: Int[Tensor, " N"]) -> Float[Tensor, " N"]:
        """The score of each row whose own style is at that place."""

    def update(self, comparison: Comparison) -> None:
        comparison, images = with_style_images(comparison)
        for row, stylized in enumerate(comparison.stylized):
            scene = comparison.scenes[row] if comparison.scenes else ""
            self.rows.append(self.vectors(stylized).mean(0, keepdim=True))
            self.styles.append(self._parts(images[row]))
            self.scenes.append(torch.tensor([zlib.crc32(scene.encode())], device=images.device))

    def compute(self) -> dict[str, Tensor]:
        found = self.of_each_row()
        if all(values.isnan().all() for values in found.values()):
            text = "there is no scene in two styles, or nothing to choose among; the scores are nan"
            warnings.warn(f"{next(iter(found))}: {text}", stacklevel=2)
        for name in (name for name in found if name.endswith("_gap")):
            styles, gap = stacked(self.styles), found[name]
            if (gap <= 0).any():
                unlike, told = (len(styles[rows].unique(dim=0)) for rows in (gap <= 0, ~gap.isnan()))
                text = f"{name.removesuffix('_gap')} does not tell {unlike} of {told} styles from another one"
                warnings.warn(f"{text}: halves of them are no more alike than of two ({name} ≤ 0)", stacklevel=2)
        return {name: values.nanmean().float() for name, values in found.items()}

    def of_each_row(self) -> dict[str, Float[Tensor, " N"]]:
        """The scores of each row."""
        rows, styles, scenes = stacked(self.rows), stacked(self.styles), stacked(self.scenes)
        if not len(rows):
            return dict.fromkeys(self.better, rows)
        gallery, places = torch.cat([styles, *self._gallery]).unique(dim=0, return_inverse=True)  # G 3 L D, N + ...
        own = places[: len(rows)]
        found = rows.new_full((gallery.shape[2], 3, len(rows)), torch.nan, dtype=torch.float64)
        for scores, looked, (whole, *halves) in zip(found, rows.unbind(1), gallery.permute(2, 1, 0, 3), strict=True):
            scores[2] = gaps(self.similar(*halves))[own]
            for scene in scenes.unique():
                of_scene = scenes == scene
                similar = self.similar(looked[of_scene], whole)
                scores[0, of_scene] = self.value(similar, own[of_scene]).double()
                if min(similar.shape) > 1:
                    scores[1, of_scene] = self.value(csls(similar), own[of_scene]).double()
        return dict(zip(self.better, found.flatten(0, 1), strict=True))

    @cached_property
    def _gallery(self) -> list[Float[Tensor, "1 3 L D"]]:
        return [self._parts(image.to(self.device)) for image in self.gallery]

    def _parts(self, image: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 3 L D"]:
        """An image and the two halves of its longer side."""
        side = 1 + int(image.shape[2] > image.shape[1])
        length = (image.shape[side] + 1) // 2
        halves = (image.narrow(side, start, length) for start in (0, image.shape[side] - length))
        return torch.stack([self.vectors(part[None])[0] for part in (image, *halves)])[None]
