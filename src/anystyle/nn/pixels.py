"""Pixels as vision transformers read them: ImageNet's normalisation, and grids of patches."""

from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def normalised(images: Float[Tensor, "*batch 3 H W"]) -> Float[Tensor, "*batch 3 H W"]:
    """Images in [0, 1], normalised by the ImageNet mean and standard deviation."""
    mean, std = images.new_tensor(IMAGENET_MEAN), images.new_tensor(IMAGENET_STD)
    return (images - mean[:, None, None]) / std[:, None, None]


def grid_of(images: Float[Tensor, "*batch 3 H W"], patch_size: int) -> tuple[int, int]:
    """Rows and columns of an image's patches."""
    height, width = images.shape[-2:]
    rows, columns = height // patch_size, width // patch_size
    if (height, width) != (rows * patch_size, columns * patch_size) or not rows * columns:
        raise UserError(
            f"images are {height}x{width} pixels; both sides must be multiples of {patch_size}: resize them"
        )
    return rows, columns
