"""Known distortions of a splat, of the cameras it is rendered from, and of its renders, in rungs of growing strength.

Lengths are shares of the shorter side of a view, so that a rung looks the same at any size. What is random is drawn
once from a seed and multiplied by the strength: a rung is the one before, further along, and strength 0 the identity.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from torch import Tensor

from anystyle.geometry.confidence import projected
from anystyle.geometry.harmonics import CONSTANT
from anystyle.geometry.transforms import matrix_from_vector
from anystyle.types import Cameras, Gaussians

NEAREST = 0.02
"""Quantile of the depths of what a view shows; there is free space in front of it."""
TINT = (-0.5, 1.0, -0.5)
"""Relative gains of red, green and blue in a cast: green, as of fluorescent light, which few paintings have."""
FLOATER_RADIUS, FLOATER_OPACITY = 0.02, 0.8
GRAIN = 0.01
"""Standard deviation of the blur that makes a texture of noise, of the shorter side of a view."""


@dataclass(frozen=True)
class Shot:
    """A stylized scene with the cameras that it is judged from.

    Args:
        gaussians: One scene.
        unstyled: The same scene without the style.
        cameras: Cameras of the judged views, of one scene.
        render: Gives views V 3 H W, sRGB in [0, 1].
        seed: Of what is random in a distortion.
    """

    gaussians: Gaussians
    unstyled: Gaussians
    cameras: Cameras
    render: Callable[[Gaussians, Cameras], Tensor]
    seed: int = 0

    @cached_property
    def views(self) -> Float[Tensor, "V 3 H W"]:
        """Its renders."""
        return self.render(self.gaussians, self.cameras)

    @cached_property
    def unstyled_views(self) -> Float[Tensor, "V 3 H W"]:
        """Renders of the unstyled scene."""
        return self.render(self.unstyled, self.cameras)


@dataclass(frozen=True)
class Distortion:
    """A ladder: ``apply`` gives the views at a strength, ``unit`` says what the numbers in ``strengths`` are."""

    title: str
    unit: str
    strengths: tuple[float, float, float, float]
    apply: Callable[[Shot, float], Tensor]


def grown(gaussians: Gaussians, factor: float) -> Gaussians:
    """The splat with its standard deviations multiplied by ``1 + factor``: it blurs, and covers more."""
    return replace(gaussians, scales=gaussians.scales * (1 + factor))


def recolored(gaussians: Gaussians, deviation: float, *, seed: int = 0) -> Gaussians:
    """The splat with normal noise of a standard deviation on each Gaussian's colour, in [0, 1], in all directions."""
    noise = _normal(gaussians.harmonics[:, :, 0].shape, seed).to(gaussians.harmonics)
    harmonics = gaussians.harmonics.clone()
    harmonics[:, :, 0] += deviation / CONSTANT * noise
    return replace(gaussians, harmonics=harmonics)


def moved(gaussians: Gaussians, cameras: Cameras, share: float, *, seed: int = 0) -> Gaussians:
    """The splat with normal noise on the centres: along each axis ``share`` of the nearest camera's shorter side."""
    pixel = (_depths(gaussians, cameras) / cameras.intrinsics[0, :, :1, 0]).nan_to_num(torch.inf).amin(0)
    pixel = pixel.masked_fill(pixel.isinf(), 0.0)  # what no view shows stays
    noise = _normal(gaussians.means.shape, seed).to(gaussians.means)
    return replace(gaussians, means=gaussians.means + share * min(cameras.size) * pixel[None, :, None] * noise)


def with_floaters(gaussians: Gaussians, cameras: Cameras, per_camera: float, *, seed: int = 0) -> Gaussians:
    """The splat with round Gaussians in the free space before each camera, in colours of the splat.

    They lie on the rays of random pixels, at 0.3 to 0.9 of the depth that nearly all of what the camera sees is
    behind; seen from that camera their standard deviation is :data:`FLOATER_RADIUS` of the shorter side. More of them
    are the fewer ones and others.
    """
    count, (height, width) = round(per_camera), cameras.size
    if not count:
        return gaussians
    added = []
    for view, depth in enumerate(_depths(gaussians, cameras)):
        draws = torch.rand(count, 4, generator=torch.Generator().manual_seed(seed + view)).to(gaussians.means)
        z = (0.3 + 0.6 * draws[:, 0]) * depth.nanquantile(NEAREST).nan_to_num(1.0)
        pixels = torch.stack([draws[:, 1] * width, draws[:, 2] * height, torch.ones_like(z)], dim=-1)
        rays = pixels @ cameras.intrinsics[0, view].inverse().mT
        pose = cameras.world_from_camera[0, view]
        means = (z[:, None] * rays) @ pose[:3, :3].mT + pose[:3, 3]
        radius = FLOATER_RADIUS * min(cameras.size) * z / cameras.intrinsics[0, view, 0, 0]
        chosen = (draws[:, 3] * gaussians.means.shape[1]).long()
        added.append(
            replace(
                gaussians,
                means=means[None],
                rotations=means.new_tensor([1.0, 0, 0, 0]).expand(1, count, 4),
                scales=radius[None, :, None].expand(1, count, 3),
                opacities=torch.full_like(z, FLOATER_OPACITY)[None],
                harmonics=gaussians.harmonics[:, chosen],
            )
        )
    return Gaussians.cat([gaussians, *added], dim=1)


def misplaced(cameras: Cameras, gaussians: Gaussians, share: float, *, seed: int = 0) -> Cameras:
    """Wrong cameras: turned and moved, each in directions of its own.

    Each turns about an axis in its image plane until the centre of its view is ``share`` of the shorter side away, and
    moves parallel to that plane until what lies in the median depth is, too.
    """
    angles = 2 * torch.pi * torch.rand(2, cameras.intrinsics.shape[1], generator=torch.Generator().manual_seed(seed))
    turn, move = (torch.stack([angle.cos(), angle.sin(), 0 * angle], -1).to(cameras.intrinsics) for angle in angles)
    reach = share * min(cameras.size) / cameras.intrinsics[0, :, 0, 0]  # V, at depth 1
    depth = _depths(gaussians, cameras).nanmedian(dim=1).values.nan_to_num(0.0)
    pose = cameras.world_from_camera.clone()
    pose[0, :, :3, 3] += torch.einsum("vij,vj->vi", pose[0, :, :3, :3], move * (reach * depth)[:, None])
    pose[0, :, :3, :3] = pose[0, :, :3, :3] @ matrix_from_vector(turn * reach.atan()[:, None])
    return replace(cameras, world_from_camera=pose)


def blurred(views: Float[Tensor, "V 3 H W"], share: float) -> Float[Tensor, "V 3 H W"]:
    """Views blurred by a Gaussian with a standard deviation of ``share`` of the shorter side."""
    sigma = share * min(views.shape[-2:])
    size = 2 * round(4 * sigma) + 1  # as wide as scipy's
    return gaussian_blur2d(views, size, (sigma, sigma), border_type="replicate") if size > 1 else views


def noisy(views: Float[Tensor, "V 3 H W"], deviation: float, *, seed: int = 0) -> Float[Tensor, "V 3 H W"]:
    """Views with normal noise of a standard deviation, independent in every pixel, channel and view."""
    return (views + deviation * _normal(views.shape, seed)).clamp(0, 1)


def tinted(views: Float[Tensor, "V 3 H W"], gain: float) -> Float[Tensor, "V 3 H W"]:
    """Views in one cast: channels times ``1 + gain`` :data:`TINT`."""
    return (views * (1 + gain * views.new_tensor(TINT)[:, None, None])).clamp(0, 1)


def flickering(views: Float[Tensor, "V 3 H W"], deviation: float, *, seed: int = 0) -> Float[Tensor, "V 3 H W"]:
    """Views each in a cast of its own: channels times the exponential of normal numbers of a standard deviation."""
    gains = _normal((*views.shape[:2], 1, 1), seed)
    return (views * (deviation * gains).exp()).clamp(0, 1)


def textured(
    views: Float[Tensor, "V 3 H W"], deviation: float, *, each: bool, seed: int = 0
) -> Float[Tensor, "V 3 H W"]:
    """Views with a texture of blurred noise that ignores the scene: the same on all, or ``each`` with its own."""
    noise = blurred(_normal((len(views) if each else 1, *views.shape[1:]), seed), GRAIN)
    return (views + deviation * noise / noise.std()).clamp(0, 1)


def faded(shot: Shot, share: float) -> Float[Tensor, "V 3 H W"]:
    """Views of a style that is taken back: so much of the unstyled scene, and the rest of the stylized one.

    Where a style changes colours alone, these are the views of colours between the two, for rendering is linear in
    them.
    """
    return torch.lerp(shot.views, shot.unstyled_views, share)


def _splat(change: Callable[..., Gaussians]) -> Callable[[Shot, float], Tensor]:
    return lambda shot, by: shot.render(change(shot.gaussians, shot.cameras, by, seed=shot.seed), shot.cameras)


def _renders(change: Callable[[Tensor, float], Tensor]) -> Callable[[Shot, float], Tensor]:
    return lambda shot, strength: change(shot.views, strength)


def _noise(change: Callable[..., Tensor], **options: bool) -> Callable[[Shot, float], Tensor]:
    return lambda shot, strength: change(shot.views, strength, seed=shot.seed, **options)


def _cameras(shot: Shot, strength: float) -> Tensor:
    return shot.render(shot.gaussians, misplaced(shot.cameras, shot.gaussians, strength, seed=shot.seed))


SIDE = "of the shorter side"
DISTORTIONS: Mapping[str, Distortion] = MappingProxyType(
    {
        "splat_blur": Distortion(
            *("splat: blur", "added to the scales of all Gaussians, relative"),
            *((0.1, 0.25, 0.5, 1.0), _splat(lambda splat, _, factor, **__: grown(splat, factor))),
        ),
        "splat_noise": Distortion(
            *("splat: noise", "SD of Gaussians' colours in [0, 1]"),
            *((0.04, 0.1, 0.2, 0.4), _splat(lambda splat, _, *deviation, **seed: recolored(splat, *deviation, **seed))),
        ),
        "splat_jitter": Distortion(
            "splat: jitter", f"SD of centres, {SIDE}", (0.002, 0.005, 0.012, 0.03), _splat(moved)
        ),
        "floaters": Distortion("splat: floaters", "per camera", (2.0, 8.0, 24.0, 72.0), _splat(with_floaters)),
        "fade": Distortion("splat: less style", "of the unstyled scene", (0.25, 0.5, 0.75, 1.0), faded),
        "cameras": Distortion("cameras: wrong", SIDE, (0.002, 0.006, 0.018, 0.05), _cameras),
        "view_blur": Distortion("views: blur", f"SD, {SIDE}", (0.002, 0.005, 0.01, 0.02), _renders(blurred)),
        "view_noise": Distortion("views: noise", "SD, colours in [0, 1]", (0.02, 0.05, 0.1, 0.2), _noise(noisy)),
        "sliding": Distortion(
            "views: sliding texture", "SD, colours in [0, 1]", (0.02, 0.05, 0.1, 0.2), _noise(textured, each=False)
        ),
        "own_texture": Distortion(
            "views: texture of their own", "SD, colours in [0, 1]", (0.02, 0.05, 0.1, 0.2), _noise(textured, each=True)
        ),
        "cast": Distortion("views: colour cast", "gain of green", (0.03, 0.07, 0.15, 0.3), _renders(tinted)),
        "flicker": Distortion("views: flicker", "SD of log gains", (0.03, 0.07, 0.15, 0.3), _noise(flickering)),
    }
)
"""All ladders by name. Strengths were chosen by eye, before any metric was computed: the first is hardly seen."""
RANDOM = ("splat_noise", "splat_jitter", "floaters", "cameras", "view_noise", "sliding", "own_texture", "flicker")
"""Those that differ between seeds."""


def _normal(shape: tuple[int, ...], seed: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def _depths(gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "V N"]:
    """Depths along z of the centres that each view shows; ``nan`` of others."""
    position, inside = projected(gaussians.means[0], cameras)
    return torch.where(inside & (gaussians.opacities > 0), position[..., 2], torch.nan)
