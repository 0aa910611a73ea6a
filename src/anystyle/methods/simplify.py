"""A scene of fewer Gaussians: pairs are merged where it shows least, and fitted to renders of the whole."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import CONSTANT
from anystyle.geometry.projection import covariances
from anystyle.geometry.transforms import wxyz_from_matrix
from anystyle.methods.colors import first_render, pixels_shown
from anystyle.methods.refine import refine
from anystyle.types import Cameras, Gaussians

NEIGHBORS, MOST = 8, 0.4
"""Partners that a Gaussian may be merged with, and the share of all that a round of merging removes at most."""
DISTANCE = 0.03
"""The squared error of a colour that a distance of a Gaussian's own size counts as."""
UNSEEN = 0.02
"""Pixels that a Gaussian which no camera shows counts as, relative to the mean of all."""
STEPS = 60
"""Steps of the fit to renders of the whole scene."""


class _Parts(NamedTuple):
    """Gaussians as they are merged, with the pixels that each covers."""

    means: Float[Tensor, "N 3"]
    covariances: Float[Tensor, "N 3 3"]
    harmonics: Float[Tensor, "N K 3"]
    opacities: Float[Tensor, " N"]
    pixels: Float[Tensor, " N"]

    def areas(self) -> Float[Tensor, " N"]:
        """In proportion to the area that each covers, over all directions; by the sums of principal minors."""
        trace, squares = self.covariances.diagonal(dim1=1, dim2=2).sum(1), self.covariances.square().sum((1, 2))
        return ((trace.square() - squares) / 2).clamp_min(1e-30).sqrt()

    def groups(self, fewer: int) -> Int[Tensor, " N"]:
        """The number of the group that each belongs to: pairs, at most ``fewer``, and singles.

        Pairs are those of least error, which is that of Ward (1963): by how much the squared error of colours and
        positions grows in the pixels that both cover.
        """
        count = min(NEIGHBORS, len(self.means) - 1)
        near = torch.from_numpy(KDTree(self.means.numpy()).query(self.means.numpy(), k=count + 1)[1])
        i, j = torch.arange(len(near)).repeat_interleave(count), near[:, 1:].reshape(-1)
        i, j = i[i != j], j[i != j]
        areas, colors = self.areas(), CONSTANT * self.harmonics[:, 0]
        apart = (self.means[i] - self.means[j]).square().sum(1) / areas[i].maximum(areas[j])
        unlike = (colors[i] - colors[j]).square().sum(1) + DISTANCE * apart
        order = (unlike / (1 / self.pixels[i] + 1 / self.pixels[j])).argsort(stable=True)
        i, j, group = i[order], j[order], torch.arange(len(near))
        while fewer and len(i):
            rank = torch.arange(len(i))
            first = torch.full_like(group, len(i)).scatter_reduce(0, torch.cat([i, j]), rank.repeat(2), "amin")
            best = ((first[i] == rank) & (first[j] == rank)).nonzero()[:fewer, 0]
            group[j[best]], fewer = i[best], fewer - len(best)
            taken = torch.zeros_like(group, dtype=torch.bool)
            taken[i[best]] = taken[j[best]] = True
            free = ~(taken[i] | taken[j])
            i, j = i[free], j[free]
        return group.unique(return_inverse=True)[1]

    def merged(self, group: Int[Tensor, " N"]) -> "_Parts":
        """Each group as one: its mean, covariance and colour in the pixels that it covers, as opaque over its area."""

        def total(values: Tensor) -> Tensor:
            return values.new_zeros(int(group.max()) + 1, *values.shape[1:]).index_add_(0, group, values)

        pixels = total(self.pixels)
        share = self.pixels / pixels[group]
        means, harmonics = total(share[:, None] * self.means), total(share[:, None, None] * self.harmonics)
        apart = self.means - means[group]
        spread = total(share[:, None, None] * (self.covariances + apart[:, :, None] * apart[:, None]))
        parts = _Parts(means, spread, harmonics, total(self.opacities * self.areas()), pixels)
        return parts._replace(opacities=(parts.opacities / parts.areas()).clamp_max(0.999))


def simplified(gaussians: Gaussians, cameras: Cameras, renderer: Renderer, number: int) -> Gaussians:
    """At most ``number`` Gaussians that show as nearly as can be what all show.

    Args:
        gaussians: A batch of one scene.
        cameras: A batch of one scene; what they show most of is kept most exactly.
        renderer: Differentiable.
        number: At least 1.
    """
    if gaussians.means.shape[1] <= number:
        return gaussians
    views = [cameras.select([view]) for view in range(cameras.intrinsics.shape[1])]
    targets = torch.cat([first_render(gaussians, view, renderer).color[0] for view in views])
    pixels = pixels_shown(gaussians, cameras, renderer).sum(0).double().cpu()
    spread = covariances(gaussians.rotations[0].double(), gaussians.scales[0].double())
    pixels = pixels + UNSEEN * pixels.mean().clamp_min(1e-9)
    given = (gaussians.means[0], spread, gaussians.harmonics[0], gaussians.opacities[0], pixels)
    parts = _Parts(*(tensor.detach().double().cpu() for tensor in given))
    while (count := len(parts.means)) > number:
        parts = parts.merged(parts.groups(min(count - number, max(1, int(MOST * count)))))
    variances, axes = torch.linalg.eigh(parts.covariances)
    axes, scales = axes * torch.linalg.det(axes)[:, None, None], variances.clamp_min(1e-16).sqrt()
    found = (parts.means, wxyz_from_matrix(axes), scales, parts.opacities, parts.harmonics)
    merged = Gaussians(*(tensor[None].to(gaussians.means) for tensor in found)).marked(gaussians.antialiased)
    return refine(merged, cameras, targets, torch.ones_like(targets[:, :1]), renderer, steps=STEPS)
