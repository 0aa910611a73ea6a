"""Style only in the colours."""

from collections.abc import Sequence

from anystyle.contracts import Placement
from anystyle.types import Site, matching_sites


class Color(Placement):
    """Style enters the colours that the Gaussian head gives, and nothing is copied.

    It fits every backbone, and each additional style costs only the injector.
    """

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, ["color"])
