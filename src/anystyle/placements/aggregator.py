"""Style in the aggregator only."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.types import Site, matching_sites


class AggregatorPlacement(Placement):
    """Style enters a copy of the aggregator, and reaches the copied head only through its features.

    Args:
        every_layer: Inject before every layer, and not just before the first and those that heads read (the paper's
            appendix: layers 0, 4, 11, 17 and 23).
    """

    def __init__(self, *, every_layer: bool = False) -> None:
        self.every_layer = every_layer

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, ["aggregator/*"], every_layer=self.every_layer)
