"""Placements that each break one promise, and what is found."""

from anystyle.testing.toy.placement import ToyPlacement
from anystyle.types import Site


class AList(ToyPlacement):
    def select(self, sites):
        return list(super().select(sites))


class Backwards(ToyPlacement):
    def select(self, sites):
        return super().select(sites)[::-1]


class Invented(ToyPlacement):
    def select(self, sites):
        return (*super().select(sites), Site("head/mine", 8))


class Silent(ToyPlacement):
    def select(self, sites):
        return tuple(sites)[-1:]


class Unsteady(ToyPlacement):
    def select(self, sites):
        self.num_sites += 1
        return super().select(sites)


CHANGED = {
    "as it is": (ToyPlacement, set()),
    "a list": (AList, {"selects sites of the backbone"}),
    "last site first": (Backwards, {"selects sites of the backbone"}),
    "a site of its own": (Invented, {"selects sites of the backbone"}),
    "nothing left": (Silent, {"says that no site is left"}),
    "another choice each time": (Unsteady, {"selects the same twice"}),
}
