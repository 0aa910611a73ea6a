"""Style in the aggregator and in the Gaussian head."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.types import Site, matching_sites


class Full(Placement):
    """Style enters a copy of the aggregator and the copied Gaussian head (the paper's "Agg", its best variant).

    Args:
        every_layer: Inject before every layer of the aggregator, and not just before the first and those that heads
            read.
        direct: As of :class:`~anystyle.placements.head.Head`.
    """

    def __init__(self, *, every_layer: bool = False, direct: bool = True) -> None:
        self.every_layer = every_layer
        self.patterns = ["aggregator/*", "head/*" if direct else "head/tokens/*"]

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, self.patterns, every_layer=self.every_layer)
