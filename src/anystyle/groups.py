"""Long captures: views in overlapping groups, each encoded alone and laid into one frame by the views they share.

A single pass over all views costs memory and time that grow with them, and a network that was trained on a few dozen
gets worse beyond. Groups keep both bounded; a capture of one group is exactly the single pass.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Backbone
from anystyle.geometry import harmonics
from anystyle.geometry.alignment import Similarity, similarity_of_cameras
from anystyle.geometry.rotations import multiply, wxyz_from_matrix
from anystyle.types import Cameras, Gaussians, Scene, Views


@dataclass(frozen=True)
class Group:
    """Some views of a capture, encoded together.

    Args:
        scene: In the group's own frame and unit.
        views: Which views of the capture it shows.
        change: From its frame to the capture's, which is the first group's; ``None`` where they are one.
        own: How many views at its end no earlier group has; only their Gaussians are used.
    """

    scene: Scene
    views: tuple[int, ...]
    change: Similarity | None
    own: int

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """What a function makes of this group, in the capture's frame."""
        made = function(self.scene)
        if self.own < len(self.views):
            made = made.map(lambda tensor: tensor[:, self._kept(made.means.shape[1])])
        return made if self.change is None else moved(made, self.change)

    def cameras(self) -> Cameras:
        """Those of its own views, in the capture's frame."""
        cameras = self.scene.cameras.select(list(range(len(self.views) - self.own, len(self.views))))
        if self.change is None:
            return cameras
        return replace(cameras, world_from_camera=self.change.moved(cameras.world_from_camera[0])[None])

    def _kept(self, count: int) -> Bool[Tensor, " N"]:
        pixels = self.scene.geometry.depth[0].numel()
        first = pixels // len(self.views) * (len(self.views) - self.own)
        device = self.scene.geometry.depth.device
        if self.scene.clusters is None:
            return torch.arange(count, device=device) >= first
        kept = torch.zeros(count, dtype=torch.bool, device=device)
        kept[self.scene.clusters.index[0, first:]] = True
        return kept


@dataclass(frozen=True)
class Capture:
    """All views of one scene."""

    groups: tuple[Group, ...]

    @property
    def cameras(self) -> Cameras:
        """Of every view, in the capture's frame."""
        if len(self.groups) == 1:
            return self.groups[0].scene.cameras
        parts = [group.cameras() for group in self.groups]
        return replace(
            parts[0],
            world_from_camera=torch.cat([part.world_from_camera for part in parts], dim=1),
            intrinsics=torch.cat([part.intrinsics for part in parts], dim=1),
        )

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """What a function, such as ``restyle`` with a style, makes of all groups, as one set of Gaussians."""
        if len(self.groups) == 1:
            return self.groups[0].gaussians(function)
        parts = [group.gaussians(function) for group in self.groups]
        return Gaussians(
            means=torch.cat([part.means for part in parts], dim=1),
            rotations=torch.cat([part.rotations for part in parts], dim=1),
            scales=torch.cat([part.scales for part in parts], dim=1),
            opacities=torch.cat([part.opacities for part in parts], dim=1),
            harmonics=torch.cat([part.harmonics for part in parts], dim=1),
        )


def split(count: int, size: int, overlap: int) -> list[tuple[int, ...]]:
    """Consecutive views in groups of ``size`` that share ``overlap``, the last ones maybe more.

    Raises:
        ValueError: Groups cannot be made so.
    """
    if size < 2 or not 1 <= overlap < size:
        raise ValueError(
            f"groups of {size} views that share {overlap}; give at least 2 views and fewer shared ones, at least 1"
        )
    if count <= size:
        return [tuple(range(count))]
    starts = [*range(0, count - size, size - overlap), count - size]
    return [tuple(range(start, start + size)) for start in starts]


def encode_groups(
    encode: Callable[[Views], Scene], views: Views, *, size: int | None, overlap: int | None = None
) -> Capture:
    """Encode a capture group by group.

    Args:
        encode: Such as :meth:`anystyle.stylizer.Stylizer.encode`.
        views: Of one scene, in capture order.
        size: Views a group; ``None`` takes all at once.
        overlap: Views that neighbours share; a quarter of a group unless it is given.

    Raises:
        ValueError: There are several scenes, or groups cannot be made so.
    """
    count = views.images.shape[1]
    if views.images.shape[0] != 1:
        raise ValueError(f"{views.images.shape[0]} scenes are given; a capture is one")
    if size is None or count <= size:
        return Capture((Group(encode(views), tuple(range(count)), None, count),))
    groups: list[Group] = []
    for places in split(count, size, max(1, size // 4) if overlap is None else overlap):
        scene = encode(views.select(list(places)))
        if not groups:
            groups.append(Group(scene, places, None, len(places)))
            continue
        last = groups[-1]
        groups.append(Group(scene, places, _joined(last, scene, places), places[-1] - last.views[-1]))
    return Capture(tuple(groups))


def with_cameras(capture: Capture, cameras: Cameras, backbone: Backbone) -> tuple[Capture, Similarity]:
    """The capture with its predicted cameras replaced by known ones, and the way from their frame to its own.

    Depth and Gaussians keep the unit that the network predicts in; the known cameras are brought there by the
    similarity that fits the predicted ones best.

    Args:
        capture: As encoded.
        cameras: Of every view, in any frame and unit.
        backbone: Decides again which pixels are fused.

    Raises:
        ValueError: Known and predicted cameras have nothing in common.
    """
    changes = []
    groups = []
    for group in capture.groups:
        chosen = cameras.select(list(group.views))
        known, predicted = chosen.world_from_camera[0], group.scene.cameras.world_from_camera[0]
        change = similarity_of_cameras(known, predicted)
        if not bool(change.scale > 1e-9):
            raise ValueError(
                "the known poses do not match the images: they move the other way from what the images show; check "
                "that they are in the images' order, or use poses=predicted"
            )
        changes.append(change)
        placed = replace(chosen, world_from_camera=change.moved(known)[None])
        geometry = replace(group.scene.geometry, cameras=placed)
        clusters = backbone.adapter.cluster(geometry, group.scene.attributes)
        back = None if not groups else composed(changes[0], inverse(change))
        groups.append(replace(group, scene=replace(group.scene, geometry=geometry, clusters=clusters), change=back))
    return Capture(tuple(groups)), changes[0]


def composed(outer: Similarity, inner: Similarity) -> Similarity:
    """First the inner change of frame, then the outer."""
    return Similarity(
        outer.scale * inner.scale,
        outer.rotation @ inner.rotation,
        outer.scale * (outer.rotation @ inner.translation) + outer.translation,
    )


def inverse(change: Similarity) -> Similarity:
    """The way back."""
    rotation = change.rotation.mT
    return Similarity(1 / change.scale, rotation, -(rotation @ change.translation) / change.scale)


def moved(gaussians: Gaussians, change: Similarity) -> Gaussians:
    """Gaussians of the old frame in the new one: places, orientations, sizes and the colours' directions."""
    turn = wxyz_from_matrix(change.rotation).expand_as(gaussians.rotations)
    turned = gaussians.harmonics
    if turned.shape[2] > 1:
        turned = harmonics.rotate(turned, change.rotation)
    return Gaussians(
        means=change.scale * gaussians.means @ change.rotation.mT + change.translation,
        rotations=multiply(turn, gaussians.rotations),
        scales=change.scale * gaussians.scales,
        opacities=gaussians.opacities,
        harmonics=turned,
    )


def _joined(last: Group, scene: Scene, places: Sequence[int]) -> Similarity:
    """From a new group's frame to the capture's, by the views it shares with the one before.

    The unit is what their depths say, pixel by pixel, for the places of few cameras say little of it.
    """
    shared = [place for place in places if place in last.views]
    before, after = [last.views.index(place) for place in shared], [places.index(place) for place in shared]
    target = last.scene.cameras.world_from_camera[0, before]
    source = scene.cameras.world_from_camera[0, after]
    ratio = last.scene.geometry.depth[0, before] / scene.geometry.depth[0, after].clamp_min(1e-12)
    scale = _median(ratio)
    rotation = similarity_of_cameras(source, target).rotation
    offset = (target[:, :3, 3] - scale * source[:, :3, 3] @ rotation.mT).mean(0)
    change = Similarity(scale, rotation, offset)
    return change if last.change is None else composed(last.change, change)


def _median(ratio: Float[Tensor, "V H W"]) -> Float[Tensor, ""]:
    return ratio.flatten().median()
