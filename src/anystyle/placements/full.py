"""Style in the aggregator and in the Gaussian head."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.types import Site, matching_sites


class Full(Placement):
    """Style enters a copy of the aggregator and the copied Gaussian head (the paper's "Agg", its best variant).

    Args:
        every_layer: Inject before every layer of the aggregator, and not just before the first and those that heads
            read.
    """

    def __init__(self, *, every_layer: bool = False) -> None:
        self.every_layer = every_layer

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, ["aggregator/*", "head/*"], every_layer=self.every_layer)
