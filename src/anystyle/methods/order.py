"""Orders of photographs that do not depend on the order given."""

from collections.abc import Iterable, Sequence

from torch import Tensor

from anystyle.methods.loop import fingerprint
from anystyle.paths import natural


def canonical_order(images: Iterable[Tensor], names: Sequence[str] = ()) -> list[int]:
    """Indices of photographs sorted by a hash of their pixels, so that results depend on their content alone.

    Names break ties between equal pixels; without names, the order given does.
    """
    hashes = [fingerprint((), {"image": image}) for image in images]
    return sorted(range(len(hashes)), key=lambda view: (hashes[view], names[view] if names else ""))


def held_out(num_views: int, every: int, names: Sequence[str] = ()) -> tuple[int, ...]:
    """Every ``every``-th view (0: none), beginning in the middle of the first ``every`` views; none of fewer views.

    Views are counted in the natural order of their names (``view2`` before ``view10``); without names, in that given.
    """
    order = sorted(range(num_views), key=lambda view: (natural(names[view]), names[view]) if names else view)
    return tuple(sorted(order[every // 2 :: every])) if 0 < every <= num_views else ()
