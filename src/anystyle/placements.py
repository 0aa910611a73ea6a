"""Placements: which sites of a backbone style enters."""

from collections.abc import Sequence
from pathlib import Path

from anystyle.contracts import Placement
from anystyle.errors import UserError
from anystyle.types import Site, matching_sites


class _Matching(Placement):
    """The sites that patterns name, of every layer or of those that heads read."""

    patterns: Sequence[str]
    every_layer: bool = True

    def select(self, sites: Sequence[Site]) -> tuple[Site, ...]:
        return matching_sites(sites, self.patterns, every_layer=self.every_layer)


class Head(_Matching):
    """Style enters the Gaussian head: its token maps and its direct path from the pixels (the paper's "Head").

    The aggregator is not copied, so each additional style costs only the head.

    Args:
        direct: Whether that path is a site, as in the published code; the paper names only the tokens.
    """

    def __init__(self, *, direct: bool = True) -> None:
        self.patterns = ["head/*" if direct else "head/tokens/*"]


class AggregatorPlacement(_Matching):
    """Style enters a copy of the aggregator, and reaches the copied head only through its features.

    Args:
        every_layer: Inject before every layer, and not just before the first and those that heads read (the paper's
            appendix: layers 0, 4, 11, 17 and 23).
    """

    patterns = ("aggregator/*",)

    def __init__(self, *, every_layer: bool = False) -> None:
        self.every_layer = every_layer


class Full(_Matching):
    """Style enters a copy of the aggregator and the copied Gaussian head (the paper's "Agg", its best variant).

    Args:
        every_layer: Inject before every layer of the aggregator, and not just before the first and those that heads
            read.
        direct: As of :class:`Head`.
    """

    def __init__(self, *, every_layer: bool = False, direct: bool = True) -> None:
        self.every_layer = every_layer
        self.patterns = ["aggregator/*", "head/*" if direct else "head/tokens/*"]


class Color(_Matching):
    """Style enters the colours that the Gaussian head gives, and nothing is copied.

    It fits every backbone, and each additional style costs only the injector.
    """

    patterns = ("color",)


class Sites(_Matching):
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
