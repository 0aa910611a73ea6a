"""What a placement promises: see :class:`anystyle.contracts.Placement`."""

import pytest

from anystyle.contracts import Placement
from anystyle.testing.asserts import ONE_LINE
from anystyle.testing.subject import Subject
from anystyle.types import Site

LAYERS = tuple(Site(f"aggregator/{layer}", 64, tapped=layer in (0, 3)) for layer in range(4))
SITES = (*LAYERS, Site("head/tokens/0", 64), Site("head/tokens/3", 64), Site("head/rgb", 32), Site("color", 3))


def test_selects_sites_of_the_backbone(plugin: Subject[Placement]) -> None:
    """It selects at least one of a backbone's sites, each once and in their order, and the same every time."""
    for sites in (SITES, [Site("aggregator/block/0", 48), Site("head/map", 24), Site("color", 12)]):
        selected = plugin.instance.select(sites)
        assert isinstance(selected, tuple) and selected, f"{selected!r} from {len(sites)} sites, not a tuple of some"
        ordered = [site for site in sites if site in selected]
        assert list(selected) == ordered, f"selected {selected}, which are not sites of {sites} in their order"
        assert plugin.instance.select(sites) == selected, "another selection of the same sites the second time"


def test_says_that_no_site_is_left(plugin: Subject[Placement]) -> None:
    """Where there is nothing to select, it raises a ValueError of one line."""
    with pytest.raises(ValueError, match=ONE_LINE):
        plugin.instance.select(())
