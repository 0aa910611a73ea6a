"""What a placement promises: see :class:`anystyle.contracts.Placement`."""

from anystyle.contracts import Placement
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.subject import Subject
from anystyle.types import Site

Plugin = Subject[Placement]

BACKBONES: dict[str, tuple[Site, ...]] = {
    "a backbone of four layers": (
        *(Site(f"aggregator/{layer}", 64, tapped=layer in (0, 3)) for layer in range(4)),
        Site("head/tokens/0", 64),
        Site("head/tokens/3", 64),
        Site("head/rgb", 32),
        Site("color", 3),
    ),
    "a backbone of one layer": (Site("aggregator/block/0", 48), Site("head/map", 24), Site("color", 12)),
}


def selects_sites_of_the_backbone(plugin: Plugin) -> None:
    """It selects at least one of a usual backbone's sites, each once, and in their order."""
    for name, sites in BACKBONES.items():
        with attempt(f"selecting from {name}", change="raise only where no site is left"):
            chosen = plugin.instance.select(sites)
        expect(
            isinstance(chosen, tuple) and len(chosen) > 0,
            given=f"{chosen!r} from {name}",
            expected="a tuple of at least one site",
            change="return `tuple(site for site in sites if ...)`, and raise a ValueError where it is empty",
        )
        expect(
            list(chosen) == [site for site in sites if site in chosen],
            given=f"from {name}: {[site.name for site in chosen]}",
            change="filter `sites`; make no sites of your own",
        )


def selects_the_same_twice(plugin: Plugin) -> None:
    """The same sites give the same choice."""
    sites = BACKBONES["a backbone of four layers"]
    first, second = plugin.instance.select(sites), plugin.instance.select(list(sites))
    expect(
        first == second,
        given=f"{[site.name for site in first]}, then {[site.name for site in second]}",
        change="decide from the sites and the options alone",
    )


def says_that_no_site_is_left(plugin: Plugin) -> None:
    """Where there is nothing to select, it raises a ValueError of one line."""
    with refusal("raise it where no site is left; name those that the backbone offers", unless="a choice of no sites"):
        plugin.instance.select(())


CHECKS: tuple[Check, ...] = (
    Check(selects_sites_of_the_backbone, needed=True),
    Check(selects_the_same_twice),
    Check(says_that_no_site_is_left),
)
