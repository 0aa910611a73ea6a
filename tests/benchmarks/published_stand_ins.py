"""Stands in for what the published code imports and its network does not use; any name can be imported from them.

- ``e3nn``: rotations of harmonics, which its Gaussian adapter imports and never calls;
- ``torchvision``: backbones that are not chosen, and pictures;
- ``xformers``: the variant with cross-attention, which is not chosen;
- ``src.dataset``, of the published code itself: readers of training data, which import much more.

Nothing timed goes through them. The network uses einops and torch-scatter, which have to be installed.
"""

import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

PACKAGES = ("e3nn", "torchvision", "xformers", "src.dataset")


class StandIn:
    """Any class or function of what is missing."""


class _Module(ModuleType):
    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return StandIn


class _Finder(MetaPathFinder, Loader):
    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        stands_in = any(f"{name}.".startswith(f"{package}.") for package in PACKAGES)
        return ModuleSpec(name, self, is_package=True) if stands_in else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _Module(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """There is nothing to run."""


def install() -> None:
    """Have them found ahead of anything installed."""
    sys.meta_path.insert(0, _Finder())
