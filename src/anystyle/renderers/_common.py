"""What every renderer begins and ends with."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.harmonics import degree_of
from anystyle.types import Cameras, Gaussians, Renders


def check(gaussians: Gaussians, cameras: Cameras, background: Sequence[float], near: float) -> None:
    """Refuse what cannot be rendered.

    Raises:
        ValueError: Gaussians and cameras are of different batches or devices, or a size or colour makes no sense.
    """
    if gaussians.means.shape[0] != cameras.world_from_camera.shape[0]:
        raise ValueError(
            f"Gaussians of {gaussians.means.shape[0]} scenes and cameras of {cameras.world_from_camera.shape[0]}; "
            "give the cameras of each scene, or expand one of the two"
        )
    if gaussians.means.device != cameras.world_from_camera.device:
        raise ValueError(
            f"Gaussians on {gaussians.means.device} and cameras on {cameras.world_from_camera.device}; "
            "move one of the two with .to(device)"
        )
    if min(cameras.size) < 1:
        raise ValueError(f"an image of {cameras.size[0]}x{cameras.size[1]} pixels; expected at least 1x1")
    if len(background) != 3:
        raise ValueError(f"a background of {len(background)} values; expected 3, one a channel in [0, 1]")
    if not near > 0:
        raise ValueError(f"near is {near}; expected a distance above 0, such as 0.01")
    degree_of(gaussians.harmonics.shape[-2])


def at_least_single(gaussians: Gaussians, cameras: Cameras) -> tuple[Gaussians, Cameras]:
    """Both in one precision: the Gaussians', or single where theirs is half, which would move them by pixels."""
    dtype = torch.promote_types(gaussians.means.dtype, torch.float32)
    return gaussians.to(dtype), cameras.to(dtype)


def over(image: Float[Tensor, "B V 5 H W"], background: Sequence[float]) -> Renders:
    """Lay what was accumulated over a background, and cut colours to [0, 1].

    Args:
        image: Red, green, blue and depth over black, and the share of light that passes.
        background: A colour in [0, 1].
    """
    color, depth, passing = image[:, :, :3], image[:, :, 3], image[:, :, 4:]
    behind = image.new_tensor(list(background))[:, None, None]  # 3 1 1
    return Renders(color=(color + passing * behind).clamp(0, 1), depth=depth, alpha=1 - passing[:, :, 0])
