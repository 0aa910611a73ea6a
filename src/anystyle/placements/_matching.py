"""Selecting sites by their names."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from anystyle.errors import UserError
from anystyle.types import Site


def matching(sites: Sequence[Site], patterns: Sequence[str], *, every_layer: bool = True) -> tuple[Site, ...]:
    """The sites whose names match any of some shell-style patterns, in the order of the computation.

    Args:
        sites: All that there are.
        patterns: Such as ``head/*``.
        every_layer: Whether layers that no head reads are taken too.

    Raises:
        UserError: A pattern matches none.
    """
    offered = [site for site in sites if site.tapped or every_layer]
    for pattern in patterns:
        if not any(fnmatchcase(site.name, pattern) for site in offered):
            names = ", ".join(site.name for site in offered) or "none"
            raise UserError(f"no site is called '{pattern}' here; there are: {names}")
    return tuple(site for site in offered if any(fnmatchcase(site.name, pattern) for pattern in patterns))
