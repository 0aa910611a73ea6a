"""What contracts feed to plugins: small, smooth, seeded, and the same on every machine."""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras, Frames, Gaussians, Views


def generator(seed: int) -> torch.Generator:
    """A generator of its own for each input, so that none depends on those made before it."""
    return torch.Generator().manual_seed(seed)


def images(number: int, size: tuple[int, int], seed: int = 0) -> Float[Tensor, "M 3 H W"]:
    """Smooth colours with some grain, in [0, 1]; image ``i`` is the same whatever ``number`` is."""
    rows = []
    for index in range(number):
        source = generator(1000 * seed + index)
        coarse = torch.rand(1, 3, 4, 4, generator=source)
        smooth = F.interpolate(coarse, size=size, mode="bilinear", align_corners=True)
        grain = torch.rand(1, 3, *size, generator=source)
        rows.append(0.8 * smooth + 0.2 * grain)
    return torch.cat(rows)


def views(batch: int, number: int, size: tuple[int, int], seed: int = 0) -> Views:
    """Photographs of ``batch`` scenes without cameras; a scene's do not depend on the others'."""
    scenes = [images(number, size, seed=seed + scene) for scene in range(batch)]
    return Views(images=torch.stack(scenes), names=tuple(f"view_{index}" for index in range(number)))


def cameras(batch: int, number: int, size: tuple[int, int]) -> Cameras:
    """Cameras side by side on an arc of radius 4 around the origin, all looking at it; each scene's arc is tilted."""
    height, width = size
    focal = float(max(size))
    intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    poses = torch.stack(
        [torch.stack([_pose(0.15 * view, 0.1 * scene) for view in range(number)]) for scene in range(batch)]
    )
    return Cameras(world_from_camera=poses, intrinsics=intrinsics.expand(batch, number, 3, 3), size=size)


def gaussians(batch: int, number: int, coefficients: int = 4, seed: int = 0) -> Gaussians:
    """Gaussians within reach of :func:`cameras`, of distinct depths; a scene's do not depend on the others'."""
    rows = []
    for scene in range(batch):
        source = generator(7000 + 1000 * seed + scene)
        # No two at one depth: where depths tie, the order of drawing is a renderer's own affair.
        heights = torch.linspace(-1, 1, number)[torch.randperm(number, generator=source)]
        across = torch.rand(number, 2, generator=source) * 2 - 1
        rows.append(
            {
                "means": torch.cat([across, heights[:, None]], dim=-1),
                "rotations": F.normalize(torch.randn(number, 4, generator=source), dim=-1),
                "scales": 0.05 + 0.25 * torch.rand(number, 3, generator=source),
                "opacities": 0.2 + 0.7 * torch.rand(number, generator=source),
                "harmonics": 0.4 * torch.randn(number, coefficients, 3, generator=source),
            }
        )
    return Gaussians(**{name: torch.stack([scene[name] for scene in rows]) for name in rows[0]})


def frames(number: int, size: tuple[int, int]) -> Frames:
    """Frames of a plane that faces the first of :func:`cameras`, with all that is known of them."""
    seen = cameras(1, number, size)
    return Frames(
        images=images(number, size),
        depth=torch.full((number, *size), 4.0),
        world_from_camera=seen.world_from_camera[0],
        intrinsics=seen.intrinsics[0],
    )


def _pose(turn: float, tilt: float) -> Float[Tensor, "4 4"]:
    cos, sin = math.cos(turn), math.sin(turn)
    yaw = torch.tensor([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    cos, sin = math.cos(tilt), math.sin(tilt)
    pitch = torch.tensor([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    rotation = yaw @ pitch
    pose = torch.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -4.0 * rotation[:, 2]
    return pose
