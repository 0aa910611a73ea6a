"""CLIP patch: align the change of random warped crops of every view with the direction of the style."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.geometry.transform import get_perspective_transform, warp_perspective
from torch import Tensor

from anystyle.contracts import Loss, StyleEncoder
from anystyle.losses.features import Reference, drawn_for_rows, reference_embeddings, resized
from anystyle.ranges import AtLeastOne, Fraction
from anystyle.types import Stylization
from anystyle.vision.eager_backward import eager_backward


class ClipPatch(Loss):
    """Move random crops of every view in the direction of the style (paper, equation 10; CLIPstyler, equation 5).

    ``mean (1 - cos(E(warp(crop(render))) - E(photograph), d))``. In training, crops and warps are drawn on the CPU from
    the global generator; in evaluation mode they are always the same.

    Args:
        crops: Number of crops a view.
        crop_size: Side of a crop in pixels, at most the views' shorter side.
        distortion: How far the corners move inwards at most, as a fraction of half a side.
        shared_crop: One crop and one warp for all views and copies, as in the published code, where all crops of a
            view are therefore the same picture.
        size: Side that warped crops (bilinear) and photographs (bicubic) are resized to, as published; ``None`` leaves
            that to the encoder.
        batch: Patches embedded at a time; affects only memory.
        reference: What ``photograph`` stands for above: the photograph, as published, or the unstyled ``render``.
        weight: In the objective.

    Example:
        >>> result = inputs.stylization(size=(64, 64))
        >>> same = replace(result, renders=replace(result.renders, color=result.views.images))
        >>> loss = ClipPatch(style_encoder=inputs.style_encoder(), distortion=0.0, size=None)  # crops are whole views
        >>> print(f"{loss(same):.2f}")
        1.00
    """

    def __init__(
        self,
        *,
        style_encoder: StyleEncoder,
        crops: AtLeastOne = 16,
        crop_size: AtLeastOne = 64,
        distortion: Fraction = 0.5,
        shared_crop: bool = False,
        size: AtLeastOne | None = 224,
        batch: AtLeastOne = 16,
        reference: Reference = "photograph",
        weight: float = 4.0,
    ) -> None:
        super().__init__()
        self._encoder = (style_encoder,)  # in a tuple, so that it is not a submodule
        self.crops, self.crop_size, self.distortion, self.shared_crop = crops, crop_size, distortion, shared_crop
        self.size, self.batch, self.weight = size, batch, weight
        self.reference: Reference = reference
        self.needs_unstyled = reference == "render"

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color, embed = result.renders.color.flatten(0, 1), self._encoder[0].embed_images
        generator = None if self.training else torch.Generator().manual_seed(0)
        # With a shared crop all copies of a view are equal, so one per view gives the same mean.
        copies = 1 if self.shared_crop else self.crops
        patches = self._patches(color.repeat_interleave(copies, 0), len(result.renders.color), generator)
        before = reference_embeddings(result, self.reference, self._encoder[0], self.size)
        target = F.normalize(result.embedding.direction, dim=-1).repeat_interleave(result.renders.color.shape[1], 0)
        total = color.new_zeros(())
        for index in torch.arange(len(patches), device=before.device).split(self.batch):
            view = index // copies

            def distance(batch: Tensor, before: Tensor = before[view], target: Tensor = target[view]) -> Tensor:
                change = F.normalize(embed(resized(batch, self.size, "bilinear")) - before, dim=-1, eps=1e-4)
                return (1 - (change * target).sum(-1)).sum()

            total = total + eager_backward(distance, patches[index])
        return total / len(patches)

    def _patches(
        self, images: Float[Tensor, "M 3 H W"], rows: int, generator: torch.Generator | None
    ) -> Float[Tensor, "M 3 c c"]:
        count, _, height, width = images.shape
        side = min(self.crop_size, height, width)

        def drawn(draw: Callable[[int], Tensor]) -> Tensor:
            """What ``draw`` gives for a number of images, for each of ours."""
            if self.shared_crop:
                return (one := draw(1)).expand(count, *one.shape[1:])
            of_rows = drawn_for_rows(rows, lambda number: draw(number * count // rows).unflatten(0, (number, -1)))
            return of_rows.flatten(0, 1)

        top = drawn(lambda number: torch.randint(height - side + 1, (number,), generator=generator)).tolist()
        left = drawn(lambda number: torch.randint(width - side + 1, (number,), generator=generator)).tolist()
        corners = drawn(lambda number: random_corners(number, side, self.distortion, generator))
        cut = [image[:, y : y + side, x : x + side] for image, y, x in zip(images.unbind(), top, left, strict=True)]
        return warp_to_corners(torch.stack(cut), corners.to(images))


def random_corners(
    count: int, side: int, distortion: float, generator: torch.Generator | None = None
) -> Float[Tensor, "count 4 2"]:
    """Random targets of the corners of a square image: each moves inwards by whole pixels on each axis.

    x and y of the upper left, upper right, lower right and lower left corner, which lie at 0 and ``side - 1`` at first
    and move by at most ``distortion`` times half a side.
    """
    inwards = torch.randint(int(distortion * (side // 2)) + 1, (count, 4, 2), generator=generator)
    return (_square(side) + torch.tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * inwards).float()


def warp_to_corners(
    images: Float[Tensor, "M 3 side side"], corners: Float[Tensor, "M 4 2"]
) -> Float[Tensor, "M 3 side side"]:
    """Square images seen in perspective, black where they end; ``corners`` as of :func:`random_corners`."""
    count, _, side, _ = images.shape
    # Corners are read as points of a plane in which a pixel's centre lies at +0.5; kornia's pixels are at integers.
    motion = get_perspective_transform(_square(side).to(images).expand(count, 4, 2) - 0.5, corners - 0.5)
    covered = torch.cat([images, torch.ones_like(images[:, :1])], dim=1)
    warped = warp_perspective(covered, motion, (side, side), mode="bilinear", padding_mode="zeros")
    # Published transforms fade the border pixels once by interpolation with black and once by their coverage.
    return warped[:, :3] * warped[:, 3:]


def _square(side: int) -> Tensor:
    return torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]]) * (side - 1)
