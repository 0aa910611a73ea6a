"""CLIP patch: pieces of every view, seen askew, point where the style lies too."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.geometry.transform import get_perspective_transform, warp_perspective
from torch import Tensor

from anystyle.contracts import Loss, StyleEncoder
from anystyle.losses._features import Reference, reference_images
from anystyle.perception.eager_backward import eager_backward
from anystyle.types import Stylization


class ClipPatch(Loss):
    """Move random crops of every view in the direction of the style (paper, equation 10; CLIPstyler, equation 5).

    ``mean (1 - cos(E(warp(crop(render))) - E(photograph), d))``. In training, crops and warps are drawn on the CPU from
    the global generator, as dropout's are; out of training they are always the same.

    Args:
        crops: How many a view.
        crop_size: Side of a crop in pixels.
        distortion: How far the corners move inwards at most, as a fraction of half a side.
        shared_crop: One crop and one warp for all views and copies, as in the published code, where all crops of a
            view are therefore the same picture.
        size: Side that warped crops (bilinear) and photographs (bicubic) are resized to, as published; none leaves
            that to the encoder.
        batch: Patches embedded at a time; a matter of memory alone.
        reference: What ``photograph`` stands for above: the photograph, as published, or the unstyled ``render``.
        weight: In the objective.
    """

    def __init__(
        self,
        *,
        style_encoder: StyleEncoder,
        crops: int = 16,
        crop_size: int = 64,
        distortion: float = 0.5,
        shared_crop: bool = False,
        size: int | None = 224,
        batch: int = 16,
        reference: Reference = "photograph",
        weight: float = 4.0,
    ) -> None:
        super().__init__()
        for name, count in (("crops", crops), ("crop_size", crop_size), ("batch", batch)):
            if count < 1:
                raise ValueError(f"loss.clip_patch.{name}={count}: give at least 1")
        if not 0 <= distortion <= 1:
            raise ValueError(f"loss.clip_patch.distortion={distortion}: give a fraction between 0 and 1")
        self._encoder = (style_encoder,)  # held, not owned
        self.crops = crops
        self.crop_size = crop_size
        self.distortion = distortion
        self.shared_crop = shared_crop
        self.size = size
        self.reference: Reference = reference
        self.needs_unstyled = reference == "render"
        self.batch = batch
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`.

        Raises:
            ValueError: The views are smaller than a crop.
        """
        color, embed = result.renders.color.flatten(0, 1), self._encoder[0].embed_images
        generator = None if self.training else torch.Generator().manual_seed(0)
        # The copies of the published code are one picture each, so one a view gives the same mean.
        copies = 1 if self.shared_crop else self.crops
        patches = self._patches(color.repeat_interleave(copies, 0), generator)
        with torch.no_grad():
            before = embed(_resized(reference_images(result, self.reference).flatten(0, 1), self.size, "bicubic"))
        target = F.normalize(result.embedding.direction, dim=-1).repeat_interleave(result.renders.color.shape[1], 0)
        total = color.new_zeros(())
        for index in torch.arange(len(patches), device=before.device).split(self.batch):
            view = index // copies

            def distance(batch: Tensor, before: Tensor = before[view], target: Tensor = target[view]) -> Tensor:
                change = F.normalize(embed(_resized(batch, self.size, "bilinear")) - before, dim=-1, eps=1e-4)
                return (1 - (change * target).sum(-1)).sum()

            total = total + eager_backward(distance, patches[index])
        return total / len(patches)

    def _patches(self, images: Float[Tensor, "M 3 H W"], generator: torch.Generator | None) -> Float[Tensor, "M 3 c c"]:
        count, _, height, width = images.shape
        side = self.crop_size
        if min(height, width) < side:
            raise ValueError(
                f"views are {height}x{width}, too small for crops of {side}; set loss.clip_patch.crop_size"
            )
        draws = 1 if self.shared_crop else count
        top = torch.randint(height - side + 1, (draws,), generator=generator).expand(count).tolist()
        left = torch.randint(width - side + 1, (draws,), generator=generator).expand(count).tolist()
        corners = random_corners(draws, side, self.distortion, generator).expand(count, 4, 2)
        cut = [image[:, y : y + side, x : x + side] for image, y, x in zip(images.unbind(), top, left, strict=True)]
        return warp_to_corners(torch.stack(cut), corners.to(images))


def random_corners(
    count: int, side: int, distortion: float, generator: torch.Generator | None = None
) -> Float[Tensor, "count 4 2"]:
    """Where the corners of a square image go: each moves inwards, a whole number of pixels on each axis.

    Args:
        count: How many images.
        side: Of an image in pixels.
        distortion: The largest move, as a fraction of half a side.
        generator: The source of chance; ``None`` for the global one.

    Returns:
        x and y of the upper left, upper right, lower right and lower left corner; the image's own are at 0 and
        ``side - 1``.
    """
    most = int(distortion * (side // 2))
    inwards = torch.randint(most + 1, (count, 4, 2), generator=generator)
    sign = torch.tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return (_square(side) + sign * inwards).float()


def warp_to_corners(
    images: Float[Tensor, "M 3 side side"], corners: Float[Tensor, "M 4 2"]
) -> Float[Tensor, "M 3 side side"]:
    """Square images seen in perspective, black where they end; ``corners`` as of :func:`random_corners`."""
    count, _, side, _ = images.shape
    # Corners are read as points of a plane in which a pixel's centre lies at +0.5; kornia's pixels are at integers.
    square = _square(side).to(images).expand(count, 4, 2)
    motion = get_perspective_transform(square - 0.5, corners - 0.5)
    covered = torch.cat([images, torch.ones_like(images[:, :1])], dim=1)
    warped = warp_perspective(covered, motion, (side, side), mode="bilinear", padding_mode="zeros")
    # Published transforms fade the border pixels once by interpolation with black and once by their coverage.
    return warped[:, :3] * warped[:, 3:]


def _square(side: int) -> Tensor:
    return torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]]) * (side - 1)


def _resized(images: Tensor, size: int | None, mode: str) -> Tensor:
    if size is None or images.shape[-2:] == (size, size):
        return images
    return F.interpolate(images, size=(size, size), mode=mode, align_corners=False)
