"""Descriptors of image points that look alike where two views show the same point."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class Matcher(nn.Module):
    """A small U-Net from images to unit descriptors on a grid of every fourth pixel.

    Args:
        descriptor: Channels of a descriptor.
        widths: Channels at strides 2, 4, 8 and 16.
    """

    def __init__(self, *, descriptor: int = 48, widths: tuple[int, int, int, int] = (24, 48, 72, 96)) -> None:
        super().__init__()
        first, second, third, fourth = widths
        self.stem = nn.Sequential(nn.Conv2d(3, first, 5, stride=2, padding=2), nn.GroupNorm(4, first), nn.GELU())
        self.down = nn.ModuleList(
            [
                nn.Sequential(_Shrink(first, second), _Residual(second)),
                nn.Sequential(_Shrink(second, third), _Residual(third)),
                nn.Sequential(_Shrink(third, fourth), _Residual(fourth), _Residual(fourth)),
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


class _Shrink(nn.Sequential):
    def __init__(self, wide: int, narrow: int) -> None:
        super().__init__(nn.Conv2d(wide, narrow, 3, stride=2, padding=1), nn.GroupNorm(4, narrow), nn.GELU())


class _Residual(nn.Module):
    def __init__(self, dim: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(dim, dim, 3, padding=1),
            nn.GroupNorm(4, dim),
            nn.GELU(),
            nn.Conv2d(dim, dim, 3, padding=1),
            nn.GroupNorm(4, dim),
        )

    def forward(self, features: Tensor) -> Tensor:
        return F.gelu(features + self.body(features))
