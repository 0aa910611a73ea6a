"""Photographs that stand twice in a capture, of which none may be held out while another one is fitted to."""

import logging
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.errors import listing
from anystyle.paths import natural
from anystyle.types import Cameras

logger = logging.getLogger(__name__)
SIDE = 64
"""Shorter side in pixels that photographs are compared at."""
ALIKE = 0.98
"""Correlation of grey values from which photographs show the same; copies of low quality have 0.99, neighbours in
captures at most 0.94."""
MAX_TURN, MAX_SHIFT = 1.0, 0.02
"""How far the cameras of such photographs may differ: in degrees, and relative to how far cameras spread. Pictures of
a round thing on a turntable are alike, too."""
SAME_PLACE = 1e-5
"""Cameras nearer to each other than this, relative to how far all spread, have one centre, as views of a panorama."""


def groups(images: Float[Tensor, "V 3 H W"], cameras: Cameras, names: Sequence[str] = ()) -> list[list[int]]:
    """Views in the natural order of their names (``view2`` before ``view10``), or that given; those alike together.

    Each group holds the views that show the same as its first one; the log names those of more than one.
    """
    order = sorted(range(len(images)), key=lambda view: (natural(names[view]), names[view]) if names else view)
    factor = SIDE / min(images.shape[-2:])
    size = [max(1, round(factor * side)) for side in images.shape[-2:]]
    gray = torch.cat([interpolate(image[None].mean(1, True), size=size, mode="area").flatten(1) for image in images])
    gray = gray - gray.mean(1, keepdim=True)
    gray = gray / gray.norm(dim=1, keepdim=True).clamp_min(1e-6)
    poses = cameras.world_from_camera[0].double()
    centers = poses[:, :3, 3]
    spread = (centers - centers.mean(0)).norm(dim=1).amax()
    found: list[list[int]] = []
    for view in order:
        for group in found:
            first = group[0]
            turn = ((poses[first, :3, :3] * poses[view, :3, :3]).sum() - 1) / 2
            near = (centers[first] - centers[view]).norm() <= MAX_SHIFT * spread
            if near and torch.rad2deg(turn.clamp(-1, 1).acos()) <= MAX_TURN and gray[first] @ gray[view] >= ALIKE:
                group.append(view)
                break
        else:
            found.append([view])
    if alike := [[names[view] if names else str(view) for view in group] for group in found if len(group) > 1]:
        logger.warning(
            "some photographs show the same, and are held out together or not at all: %s",
            listing([" = ".join(group) for group in alike]),
        )
    return found


def held_out(photographs: Sequence[Sequence[int]], every: int, cameras: Cameras | None = None) -> tuple[int, ...]:
    """Every ``every``-th of :func:`groups` (0: none), from the middle of the first ``every`` on; none of fewer.

    Groups whose first cameras stand in one place, such as views of a panorama, which overlap, count as one.
    """
    places = [list(group) for group in photographs]
    if cameras is not None:
        centers, near = cameras.world_from_camera[0, :, :3, 3].double(), same_place(cameras)
        places = list[list[int]]()
        for group in photographs:
            place = next((one for one in places if (centers[one[0]] - centers[group[0]]).norm() < near), None)
            places.append(list(group)) if place is None else place.extend(group)
    chosen = places[every // 2 :: every] if 0 < every <= len(places) else []
    return tuple(sorted(view for group in chosen for view in group))


def to_try(photographs: Sequence[Sequence[int]], heldout: Sequence[int], cameras: Cameras) -> tuple[int, ...]:
    """Every second of the others, for a trial that does not see them."""
    return held_out([group for group in photographs if group[0] not in heldout], 2, cameras)


def same_place(cameras: Cameras) -> float:
    """Distance up to which cameras show no parallax, as the views of a panorama."""
    centers = cameras.world_from_camera[0, :, :3, 3].double()
    return SAME_PLACE * float((centers - centers.mean(0)).norm(dim=1).amax())
