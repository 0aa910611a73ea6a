"""Orders of photographs that do not depend on how they are given."""

from collections.abc import Iterable, Sequence

from torch import Tensor

from anystyle.io.names import natural
from anystyle.reconstructions.loop import fingerprint


def canonical_order(images: Iterable[Tensor], names: Sequence[str] = ()) -> list[int]:
    """Indices of photographs by a hash of their pixels, so that what is computed depends on what they show alone.

    Args:
        images: Of each photograph, the pixels.
        names: Tell apart those whose pixels are the same; without names they stay as they are.
    """
    hashes = [fingerprint((), {"image": image}) for image in images]
    return sorted(range(len(hashes)), key=lambda view: (hashes[view], names[view] if names else ""))


def held_out(num_views: int, every: int, names: Sequence[str] = ()) -> tuple[int, ...]:
    """Every so many-th view, beginning in the middle of the first stretch; none where less than one stretch is.

    Args:
        num_views: So many there are.
        every: Views of a stretch; 0 holds out none.
        names: Views are counted in the natural order of their names, as cameras number photographs; as they are given
            where they have none.
    """
    order = sorted(range(num_views), key=lambda view: (natural(names[view]), names[view]) if names else view)
    return tuple(sorted(order[every // 2 :: every])) if 0 < every <= num_views else ()
