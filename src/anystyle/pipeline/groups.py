"""Long captures: views in overlapping groups, each encoded alone and laid into one frame by the views they share.

A single pass over all views costs memory and time that grow with them, and a network that was trained on a few dozen
gets worse beyond. Groups keep both bounded; a capture of one group is exactly the single pass.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool
from torch import Tensor

from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity, similarity_of_cameras
from anystyle.types import Cameras, Gaussians, Scene, Views


@dataclass(frozen=True)
class Group:
    """Some views of a capture, encoded together.

    Args:
        scene: In the group's own frame and unit.
        views: Which views of the capture it shows.
        capture_from_group: From its frame to the capture's, which is the first group's; ``None`` where they are one.
        num_new: How many views at its end no earlier group has; only their Gaussians are used.
    """

    scene: Scene
    views: tuple[int, ...]
    capture_from_group: Similarity | None
    num_new: int

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """The Gaussians that a function gives for this group's new views, in the capture's frame."""
        gaussians = function(self.scene)
        if self.num_new < len(self.views):
            new = self._of_new_views(gaussians.means.shape[1])
            gaussians = gaussians.map(lambda tensor: tensor[:, new])
        return gaussians if self.capture_from_group is None else self.capture_from_group.gaussians(gaussians)

    def cameras(self) -> Cameras:
        """The cameras of the new views, in the capture's frame."""
        cameras = self.scene.cameras.select(slice(len(self.views) - self.num_new, None))
        if self.capture_from_group is None:
            return cameras
        return replace(cameras, world_from_camera=self.capture_from_group.poses(cameras.world_from_camera[0])[None])

    def _of_new_views(self, num_gaussians: int) -> Bool[Tensor, " N"]:
        depth = self.scene.geometry.depth
        first_pixel = depth[0, 0].numel() * (len(self.views) - self.num_new)
        if self.scene.clusters is None:
            return torch.arange(num_gaussians, device=depth.device) >= first_pixel
        new = torch.zeros(num_gaussians, dtype=torch.bool, device=depth.device)
        new[self.scene.clusters.index[0, first_pixel:]] = True
        return new


@dataclass(frozen=True)
class Capture:
    """All views of one scene."""

    groups: tuple[Group, ...]

    @classmethod
    def of(cls, scene: Scene) -> "Capture":
        """A capture of one group."""
        num_views = scene.views.images.shape[1]
        return cls((Group(scene, tuple(range(num_views)), None, num_views),))

    @property
    def cameras(self) -> Cameras:
        """Of every view, in the capture's frame."""
        return Cameras.cat([group.cameras() for group in self.groups], dim=1)

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """The Gaussians that a function, such as ``restyle`` with a style, gives for all groups, as one set."""
        return Gaussians.cat([group.gaussians(function) for group in self.groups], dim=1)


def split(num_views: int, size: int, overlap: int) -> list[tuple[int, ...]]:
    """Consecutive views in groups of ``size`` that share ``overlap``, the last ones maybe more."""
    if size < 2 or not 1 <= overlap < size:
        raise UserError(
            f"groups of {size} views that share {overlap}; give at least 2 views and fewer shared ones, at least 1"
        )
    if num_views <= size:
        return [tuple(range(num_views))]
    starts = [*range(0, num_views - size, size - overlap), num_views - size]
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
    """
    num_scenes, num_views = views.images.shape[:2]
    if num_scenes != 1:
        raise UserError(f"{num_scenes} scenes are given; a capture is one")
    if size is None or num_views <= size:
        return Capture.of(encode(views))
    groups: list[Group] = []
    for indices in split(num_views, size, max(1, size // 4) if overlap is None else overlap):
        scene = encode(views.select(list(indices)))
        if not groups:
            groups.append(Group(scene, indices, None, len(indices)))
            continue
        last = groups[-1]
        groups.append(Group(scene, indices, _capture_from_group(last, scene, indices), indices[-1] - last.views[-1]))
    return Capture(tuple(groups))


def _capture_from_group(last: Group, scene: Scene, indices: Sequence[int]) -> Similarity:
    """From a new group's frame to the capture's, by the views it shares with the one before.

    The unit is what their depths say, pixel by pixel, for the positions of few cameras say little of it.
    """
    shared = [index for index in indices if index in last.views]
    before, after = [last.views.index(index) for index in shared], [indices.index(index) for index in shared]
    target = last.scene.cameras.world_from_camera[0, before]
    source = scene.cameras.world_from_camera[0, after]
    ratio = last.scene.geometry.depth[0, before] / scene.geometry.depth[0, after].clamp_min(1e-12)
    scale = ratio.flatten().median()
    rotation = similarity_of_cameras(source, target).rotation
    translation = (target[:, :3, 3] - scale * source[:, :3, 3] @ rotation.mT).mean(0)
    last_from_group = Similarity(scale, rotation, translation)
    return last_from_group if last.capture_from_group is None else last.capture_from_group.after(last_from_group)
