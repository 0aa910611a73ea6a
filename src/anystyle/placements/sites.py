"""Style at sites that are named one by one."""

from collections.abc import Sequence
from pathlib import Path

from anystyle.contracts import Placement
from anystyle.errors import UserError
from anystyle.types import Site, matching_sites


class Sites(Placement):
    """Style enters the sites that patterns name.

    Args:
        patterns: Names of sites such as ``head/direct`` and ``color``, or patterns of them such as ``aggregator/1?``
            and ``head/*``.
    """

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"patterns": ("*",)}

    def __init__(self, *, patterns: Sequence[str]) -> None:
        if not patterns:
            raise UserError("placement.patterns is empty; name a site, such as placement.patterns=[color]")
        self.patterns = tuple(patterns)

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, self.patterns, every_layer=True)
