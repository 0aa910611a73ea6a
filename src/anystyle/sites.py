"""Selecting among the places where style may enter a backbone."""

from collections.abc import Sequence

from anystyle.types import Site


def select_sites(sites: Sequence[Site], parts: Sequence[str], *, every_layer: bool) -> tuple[Site, ...]:
    """The sites of some parts of a backbone, in the order of the computation.

    Args:
        sites: All that the backbone offers.
        parts: First words of their names, such as ``head``.
        every_layer: Whether layers that no head reads are taken too.

    Raises:
        ValueError: A part offers no site.
    """
    chosen = tuple(site for site in sites if _part(site) in parts and (site.tapped or every_layer))
    offered = sorted({_part(site) for site in sites})
    for part in parts:
        if part not in {_part(site) for site in chosen}:
            raise ValueError(f"the backbone offers no site of its {part}; it offers sites of: {', '.join(offered)}")
    return chosen


def _part(site: Site) -> str:
    return site.name.partition("/")[0]
