"""Style in the Gaussian head only."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.types import Site, matching_sites


class Head(Placement):
    """Style enters the Gaussian head: its token maps and its direct path from the pixels (the paper's "Head").

    The aggregator is not copied, so each additional style costs only the head.

    Args:
        direct: Whether that path is a site, as in the published code; the paper names only the tokens.
    """

    def __init__(self, *, direct: bool = True) -> None:
        self.patterns = ["head/*" if direct else "head/tokens/*"]

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, self.patterns)
