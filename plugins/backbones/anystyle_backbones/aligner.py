"""Camera poses from matches: an alternative to regressing them that a small network can learn."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from anystyle.types import Cameras, Geometry
from anystyle_backbones.alignment import MatchedPoints, align
from anystyle_backbones.reference_view import in_order, reference_first


class Matcher(nn.Module):
    """A small U-Net from images to descriptors of every fourth pixel; widths are those at strides 2, 4, 8 and 16."""

    def __init__(self, *, descriptor: int = 48, widths: tuple[int, int, int, int] = (24, 48, 72, 96)) -> None:
        super().__init__()
        first, second, third, fourth = widths
        self.stem = nn.Sequential(nn.Conv2d(3, first, 5, stride=2, padding=2), nn.GroupNorm(4, first), nn.GELU())
        self.down = nn.ModuleList(
            [
                nn.Sequential(_shrink(first, second), _Residual(second)),
                nn.Sequential(_shrink(second, third), _Residual(third)),
                nn.Sequential(_shrink(third, fourth), _Residual(fourth), _Residual(fourth)),
            ]
        )
        self.lateral = nn.ModuleList([nn.Conv2d(fourth, third, 1), nn.Conv2d(third, second, 1)])
        self.up = nn.ModuleList([_Residual(third), _Residual(second)])
        self.last = nn.Conv2d(second, descriptor, 3, padding=1)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M d h w"]:
        """Descriptors, not yet normalised, of sRGB images in [0, 1]."""
        current = self.stem(images * 4 - 2)
        levels: list[Tensor] = []
        for stage in self.down:
            current = stage(current)
            levels.append(current)
        for lateral, refine, level in zip(self.lateral, self.up, (levels[1], levels[0]), strict=True):
            wider = F.interpolate(lateral(current), size=level.shape[-2:], mode="bilinear", align_corners=False)
            current = refine(wider + level)
        return self.last(current)


def _shrink(dim: int, wider: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(dim, wider, 3, stride=2, padding=1), nn.GroupNorm(4, wider), nn.GELU())


class _Residual(nn.Module):
    def __init__(self, dim: int) -> None:
        super().__init__()
        first, second = ((nn.Conv2d(dim, dim, 3, padding=1), nn.GroupNorm(4, dim)) for _ in range(2))
        self.body = nn.Sequential(*first, nn.GELU(), *second)

    def forward(self, features: Tensor) -> Tensor:
        return F.gelu(features + self.body(features))


DOUBTFUL = 1.5 / 112
"""Error of a match, as a fraction of the image's width, at which its Cauchy weight is a half."""
RADIUS = 2
"""Radius of the window of cells around the likeliest one over which the position of a match is averaged."""


class ViewMatches(NamedTuple):
    """Where points of views after the first, row by row, are in the first, and how surely."""

    cells: Float[Tensor, "B v P 2"]  # column and row, averaged around the likeliest cell
    confidence: Float[Tensor, "B v P"]  # that both are each other's likeliest
    grid: tuple[int, int]  # rows and columns

    @classmethod
    @torch.no_grad()
    def of(cls, correlation: Float[Tensor, "B v r c r c"]) -> "ViewMatches":
        """The matches of a correlation."""
        rows, columns = correlation.shape[-2:]
        logits = correlation.flatten(4).flatten(2, 3)
        with torch.autocast(correlation.device.type, enabled=False):
            probability = logits.softmax(-1)
            mutual = probability * logits.softmax(-2)
        best = mutual.argmax(-1)
        row, column = best // columns, best % columns
        total, confidence = torch.zeros_like(mutual[..., 0]), torch.zeros_like(mutual[..., 0])
        cells = torch.zeros(*best.shape, 2, device=best.device)
        for dy, dx in product(range(-RADIUS, RADIUS + 1), repeat=2):
            y, x = row + dy, column + dx
            inside = (y >= 0) & (y < rows) & (x >= 0) & (x < columns)
            index = (y.clamp(0, rows - 1) * columns + x.clamp(0, columns - 1))[..., None]
            mass = probability.gather(-1, index)[..., 0] * inside
            total = total + mass
            cells = cells + mass[..., None] * torch.stack([x, y], dim=-1)
            confidence = confidence + mutual.gather(-1, index)[..., 0] * inside
        return cls(cells / total.clamp_min(1e-12)[..., None], confidence, (rows, columns))

    @classmethod
    def cat(cls, matches: Sequence["ViewMatches"]) -> "ViewMatches":
        """Those of several parts of the same views."""
        cells, confidence, grids = zip(*matches, strict=True)
        return cls(torch.cat(cells, dim=1), torch.cat(confidence, dim=1), grids[0])


class Aligner(nn.Module):
    """Align every camera with the reference view by matching points.

    Not in published networks, which regress poses from camera tokens; a network of a few million parameters does not
    learn to in hours. Points of the views are compared by descriptors, and the rigid motion that explains the
    matches is computed from them and the depth in closed form. Nothing is optimised at test time.

    To supervise the matches, use a forward pre-hook: the first argument of :meth:`forward` is the correlation, with its
    gradient.

    Args:
        descriptor: Channels in which points are compared.
    """

    def __init__(self, *, descriptor: int = 48) -> None:
        super().__init__()
        self.matcher = Matcher(descriptor=descriptor)
        self.log_sharpness = nn.Parameter(torch.tensor(math.log(10.0)))

    def correlation(self, images: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B v r c r c"]:
        """Logits that points of each view after the first, row by row, are those of the first."""
        descriptors = self.matcher(images.flatten(0, 1)).float().unflatten(0, images.shape[:2])
        unit = F.normalize(descriptors, dim=2)
        cosines = torch.einsum("bvdij,bdkl->bvijkl", unit[:, 1:], unit[:, 0])
        return cosines * self.log_sharpness.exp()

    def aligned(
        self, geometry: Geometry, images: Float[Tensor, "B V 3 H W"], reference: Int[Tensor, " B"] | None = None
    ) -> Geometry:
        """The geometry with poses from matches; the world's frame is the reference view's, by default the first."""
        if reference is not None:
            order = reference_first(reference, images.shape[1])
            back = order.argsort(dim=1)
            aligned = self.aligned(geometry.map(lambda tensor: in_order(tensor, order)), in_order(images, order))
            return aligned.map(lambda tensor: in_order(tensor, back))
        if self.training or images.shape[1] == 1:
            pose = self(self.correlation(images), geometry.cameras, geometry.depth)
        else:  # one view at a time: a correlation grows with the fourth power of an image's side
            pairs = (self.correlation(images[:, [0, view]]) for view in range(1, images.shape[1]))
            pose = self.poses(ViewMatches.cat([*map(ViewMatches.of, pairs)]), geometry.cameras, geometry.depth)
        return replace(geometry, cameras=replace(geometry.cameras, world_from_camera=pose))

    def forward(
        self, correlation: Float[Tensor, "B v r c r c"], cameras: Cameras, depth: Float[Tensor, "B V H W"]
    ) -> Float[Tensor, "B V 4 4"]:
        """Poses from the matches of a correlation."""
        return self.poses(ViewMatches.of(correlation), cameras, depth)

    @torch.no_grad()
    def poses(
        self, matches: ViewMatches, cameras: Cameras, depth: Float[Tensor, "B V H W"]
    ) -> Float[Tensor, "B V 4 4"]:
        """Poses, the first view's at the origin and the others where they fit; of the cameras intrinsics are used.

        They carry no gradient: matches and depth are supervised directly, and poses from bad matches only add noise.
        """
        batch, views = depth.shape[:2]
        (height, width), (rows, columns) = cameras.size, matches.grid
        cell, weight = matches.cells.flatten(0, 1), matches.confidence.flatten(0, 1)
        size = depth.new_tensor([width / columns, height / rows])
        cells = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).flip(1).to(depth)  # P 2, column and row
        sources = ((cells + 0.5) * size).expand(len(cell), -1, -1)
        scale = float(DOUBTFUL * width / cameras.intrinsics[:, :, 0, 0].mean())
        with torch.autocast(depth.device.type, enabled=False):
            source_ray, source = _unproject(sources, cameras, depth, slice(1, None))
            target_ray, target = _unproject((cell + 0.5) * size, cameras, depth, slice(0, 1))
            motion = align(MatchedPoints(source, target, source_ray, target_ray, weight), scale=scale)
        pose = torch.eye(4, dtype=depth.dtype, device=depth.device).expand(batch, views, 4, 4).clone()
        pose[:, 1:, :3, :3], pose[:, 1:, :3, 3] = (part.unflatten(0, (batch, views - 1)) for part in motion)
        return pose


def _unproject(
    pixels: Float[Tensor, "M P 2"], cameras: Cameras, depth: Float[Tensor, "B V H W"], views: slice
) -> tuple[Float[Tensor, "M P 2"], Float[Tensor, "M P 3"]]:
    """Rays and points of pixels; a single view serves all rows of its scene."""
    height, width = cameras.size
    count = depth.shape[1] - 1
    chosen = depth[:, views].expand(-1, count, -1, -1).flatten(0, 1)
    intrinsics = cameras.intrinsics[:, views].expand(-1, count, -1, -1).flatten(0, 1)
    grid = pixels * pixels.new_tensor([2 / width, 2 / height]) - 1
    sampled = F.grid_sample(chosen[:, None], grid[:, None], padding_mode="border", align_corners=False)[:, 0, 0]
    ray = (pixels - intrinsics[:, None, :2, 2]) / intrinsics.diagonal(dim1=-2, dim2=-1)[:, None, :2]
    return ray, F.pad(ray, (0, 1), value=1.0) * sampled[..., None]
