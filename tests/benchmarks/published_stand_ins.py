"""Stands in for what the published code imports and its network does not use; any name can be imported from them.

- ``e3nn``: rotations of harmonics, which its Gaussian adapter imports and never calls;
- ``torchvision``: backbones that are not chosen, and pictures;
- ``xformers``: it has no attention for the CPU; PyTorch's own takes its place, and all else is not chosen;
- ``torch_scatter``, which has to be compiled: sums and maxima of rows by PyTorch's own, a hundredth of the time;
- ``src.dataset``, of the published code itself: readers of training data, which import much more.

Nothing else that is timed goes through them. The networks use einops, which has to be installed.
"""

import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import torch.nn.functional as F
from torch import Tensor

PACKAGES = ("e3nn", "torch_scatter", "torchvision", "xformers", "src.dataset")


class StandIn:
    """Any class or function of what is missing."""


def attention(query: Tensor, key: Tensor, value: Tensor, *, scale: float | None = None, p: float = 0.0) -> Tensor:
    """``memory_efficient_attention`` of ``B N heads C`` by PyTorch's kernels."""
    query, key, value = (each.transpose(1, 2) for each in (query, key, value))
    return F.scaled_dot_product_attention(query, key, value, dropout_p=p, scale=scale).transpose(1, 2)


def scatter_add(rows: Tensor, index: Tensor, dim: int = 0) -> Tensor:
    """Sums of the rows of each index."""
    return rows.new_zeros(int(index.max()) + 1, *rows.shape[1:]).index_add_(dim, index, rows)


def scatter_max(values: Tensor, index: Tensor, dim: int = 0) -> tuple[Tensor, None]:
    """The largest of the values of each index; where it lies is not told."""
    return values.new_empty(int(index.max()) + 1).scatter_reduce_(dim, index, values, "amax", include_self=False), None


COMPUTED = {"memory_efficient_attention": attention, "scatter_add": scatter_add, "scatter_max": scatter_max}


class _Module(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return COMPUTED.get(name, StandIn)


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
