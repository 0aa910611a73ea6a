"""How the rasteriser's kernels are compiled."""

from functools import partial

from anystyle.compiled import CONTRACT
from anystyle.compiled import compiled as _compiled

compiled = partial(_compiled, fastmath=CONTRACT)
"""A product and a sum may be fused; the order of a sum stays."""

summed = partial(_compiled, fastmath=CONTRACT | {"reassoc"})
"""Sums may be reordered, so that they compile to vector instructions; their order is still the same in every run."""
