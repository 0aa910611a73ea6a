"""LPIPS of the pairs of a comparison: every image is looked at once, whoever asks."""

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._pairs import Pairs
from anystyle.perception import pictures
from anystyle.perception.lpips import Lpips
from anystyle.perception.memo import MEMO


def pair_lpips(network: Lpips, some: Pairs, *, size: int | None, rounded: bool, gray: bool) -> Float[Tensor, " M"]:
    """LPIPS of stylized images and photographs.

    Args:
        network: LPIPS.
        some: The pairs.
        size: Of the shorter side; ``None`` keeps it.
        rounded: Whether images have 8 bits, as files.
        gray: Whether colour is taken away first.
    """

    def prepared(images: Tensor) -> Tensor:
        if size is not None:
            images = pictures.resized(images, size, rounded=rounded)
        elif rounded:
            images = pictures.eight_bit(images)
        return pictures.gray(images, rounded=rounded) if gray else images

    def distances() -> Tensor:
        maps = MEMO.rows(some.content, some.content_marks, ("maps", *what), lambda x: network.describe(prepared(x)))
        return network.compare(network.describe(prepared(some.stylized)), maps)

    what = ("lpips", network.source.identity, size, rounded, gray)
    return MEMO.values([*zip(some.stylized_marks, some.content_marks, strict=True)], what, some.stylized, distances)
