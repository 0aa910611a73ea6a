"""What a fit takes of photographs: where they count, and where nothing is there."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import interpolate, max_pool2d

from anystyle.types import Cameras, Views
from anystyle_captures.pixels import pixels_of

COVERED = 0.1
"""Alpha of a photograph below which a pixel is empty."""


@dataclass(frozen=True)
class Masks:
    """What photographs say of their pixels, as :class:`~anystyle.types.Views` has it."""

    alpha: Float[Tensor, "V H W"]
    valid: Bool[Tensor, "V H W"]

    @classmethod
    def of(cls, views: Views) -> "Masks | None":
        """Those of the photographs of one scene, if there are any."""
        if views.alpha is None and views.valid is None:
            return None
        ones = torch.ones_like(views.images[0, :, 0])
        alpha = ones if views.alpha is None else views.alpha[0]
        return cls(alpha, ones.bool() if views.valid is None else views.valid[0])

    @property
    def measured(self) -> Bool[Tensor, "V H W"]:
        """Where a photograph shows the scene."""
        return self.valid & (self.alpha >= COVERED)

    def resized(self, size: tuple[int, int]) -> "Masks":
        """The same for images that area interpolation brings to ``size``; a pixel counts if all of it does."""
        alpha, valid = interpolate(torch.stack([self.alpha, self.valid.float()]), size=size, mode="area")
        return Masks(alpha, valid == 1)

    def select(self, views: Sequence[int]) -> "Masks":
        """Those of some views."""
        return Masks(self.alpha[list(views)], self.valid[list(views)])

    def straight(self, images: Float[Tensor, "V 3 H W"]) -> Float[Tensor, "V 3 H W"]:
        """The colours of what is there, without the white that shows through."""
        alpha = self.alpha[:, None]
        return ((images - (1 - alpha)) / alpha.clamp_min(COVERED)).clamp(0, 1)

    @torch.no_grad()
    def asked_for(self, means: Float[Tensor, "N 3"], cameras: Cameras) -> Bool[Tensor, " N"]:
        """Which points no photograph shows to be empty, and at least one shows, of those that lie in any."""
        empty, shown, inside = (torch.zeros_like(means[:, 0], dtype=torch.bool) for _ in range(3))
        # One pixel more than what is covered: cameras are not exact.
        covered = max_pool2d(self.alpha, 3, 1, 1) >= COVERED
        for view in range(len(self.alpha)):
            row, column, _, within = pixels_of(means, cameras, view)
            valid = self.valid[view, row, column] & within
            inside |= within
            shown |= valid & covered[view, row, column]
            empty |= valid & ~covered[view, row, column]
        return ~empty & (shown | ~inside)
