"""An order of photographs that does not depend on the order given."""

import hashlib
from collections.abc import Iterable, Sequence

from torch import Tensor


def canonical_order(images: Iterable[Tensor], names: Sequence[str] = ()) -> list[int]:
    """Indices of photographs sorted by a hash of their pixels, so that results depend only on their content.

    Names break ties between equal pixels; without names, the order given does.
    """
    # The prefix fixes the order that the scores in docs/ were measured with: cameras depend on it a little.
    hashes = [hashlib.sha256(b"()" + image.detach().cpu().contiguous().numpy().tobytes()).digest() for image in images]
    return sorted(range(len(hashes)), key=lambda view: (hashes[view], names[view] if names else ""))
