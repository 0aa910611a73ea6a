"""Photographs and tracks as a lens without distortion would have them."""

from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float64, UInt8

from anystyle.reconstructions.sfm.model import Lens, SparseModel, Tracks

Array = np.ndarray
STRAIGHT = 0.1
"""Pixels of distortion at the corner that are left as they are."""
NEWTON = 8
"""Steps of inverting the distortion of a radius."""


def pinhole(lens: Lens) -> Lens:
    """The lens without distortion whose image is full and shows as much as it can.

    Focal lengths change by one factor; the centre and the size stay.
    """
    if not is_distorted(lens):
        return replace(lens, radial=0.0)
    border = undistorted_rays(lens, _border(lens))
    straight = np.abs(_border(lens) - lens.center) / lens.focal
    outward = straight > 1e-9
    # Every border pixel of the result must look at something inside of the photograph.
    factor = float((straight[outward] / np.abs(border[outward])).max())
    return replace(lens, focal=(lens.focal[0] * factor, lens.focal[1] * factor), radial=0.0)


def is_distorted(lens: Lens) -> bool:
    """Whether the distortion moves any pixel noticeably."""
    corner = np.hypot(lens.size[1] / 2 / lens.focal[0], lens.size[0] / 2 / lens.focal[1])
    return bool(abs(lens.radial) * corner**3 * max(lens.focal) > STRAIGHT)


def undistorted_image(pixels: UInt8[Array, "H W 3"], lens: Lens) -> UInt8[Array, "H W 3"]:
    """The photograph as the lens of :func:`pinhole` would have taken it, bilinearly resampled."""
    if not is_distorted(lens):
        return pixels
    straight, (height, width) = pinhole(lens), lens.size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = (np.stack([x, y], axis=-1) - straight.center) / straight.focal
    seen = rays * (1 + lens.radial * np.square(rays).sum(-1, keepdims=True)) * lens.focal + lens.center
    grid = torch.from_numpy(2 * seen / np.array([width, height]) - 1).float()
    image = torch.tensor(pixels).permute(2, 0, 1).float()
    sampled = F.grid_sample(image[None], grid[None], align_corners=False, padding_mode="border")[0]
    return sampled.round().byte().permute(1, 2, 0).numpy()


def undistorted_rays(lens: Lens, pixels: Float64[Array, "N 2"]) -> Float64[Array, "N 2"]:
    """Where rays through pixels of the photograph meet z = 1."""
    distorted = (pixels - lens.center) / lens.focal
    radius = np.linalg.norm(distorted, axis=-1, keepdims=True)
    straight = radius.copy()
    for _ in range(NEWTON):
        slope = (1 + 3 * lens.radial * straight**2).clip(0.1)
        straight -= (straight * (1 + lens.radial * straight**2) - radius) / slope
    return distorted * np.where(radius > 1e-12, straight / radius.clip(1e-12), 1.0)


def undistorted_model(model: SparseModel) -> SparseModel:
    """The same model with pinhole lenses, and tracks in pixels of the undistorted photographs."""
    pixels = model.tracks.pixel.copy()
    for view, lens in enumerate(model.lenses):
        seen = model.tracks.view == view
        if lens is not None and seen.any():
            straight = pinhole(lens)
            rays = undistorted_rays(lens, pixels[seen]) if is_distorted(lens) else None
            pixels[seen] = pixels[seen] if rays is None else rays * straight.focal + straight.center
    lenses = tuple(None if lens is None else pinhole(lens) for lens in model.lenses)
    return replace(model, lenses=lenses, tracks=Tracks(model.tracks.point, model.tracks.view, pixels))


def _border(lens: Lens) -> Float64[Array, "N 2"]:
    """Places all along the border of the image."""
    height, width = lens.size
    across, down = np.linspace(0, width, 65), np.linspace(0, height, 65)
    sides = [np.stack([across, np.full(65, y)], 1) for y in (0.0, float(height))]
    sides += [np.stack([np.full(65, x), down], 1) for x in (0.0, float(width))]
    return np.concatenate(sides)
