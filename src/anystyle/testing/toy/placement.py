"""The last sites: the smallest placement with an option."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.ranges import AtLeastOne
from anystyle.types import Site


class ToyPlacement(Placement):
    """Style enters the last sites of a backbone.

    Args:
        num_sites: How many.
    """

    def __init__(self, *, num_sites: AtLeastOne = 2) -> None:
        self.num_sites = num_sites

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        if not sites:
            raise ValueError("the backbone offers no site; this placement needs at least one")
        return tuple(sites)[-self.num_sites :]
