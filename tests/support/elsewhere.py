"""A device that is none: its tensors have values, and an operation of one with a tensor of the CPU is an error.

As on a graphics card, numbers alone (tensors without dimensions) may come from the CPU, and values leave by ``item``,
``cpu`` and ``to``. New tensors are made there where it is asked for by ``device=``, which reads ``meta``.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

from anystyle.nn.tokens import constant
from anystyle_backbones.blocks import grid_rotary
from anystyle_backbones.dpt import scaled_waves

DEVICE = torch.device("meta")
_CPU = torch.device("cpu")
_aten = torch.ops.aten


class There(Tensor):
    """A tensor of that device."""

    inner: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> "There":
        """Wrap a tensor of the CPU."""
        made = Tensor._make_wrapper_subclass(
            cls,
            inner.shape,
            strides=inner.stride(),
            dtype=inner.dtype,
            device=DEVICE,
            storage_offset=inner.storage_offset(),
        )
        made.inner = inner
        return made

    def __repr__(self, **_: Any) -> str:
        """Say so."""
        return f"There({self.inner!r})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Compute on the CPU, if all are there."""
        return _run(func, args, kwargs or {})


class _Literals(TorchFunctionMode):
    """Tensors of given numbers, which PyTorch makes below the dispatcher."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func is Tensor.tolist and isinstance(args[0], There):
            return args[0].inner.tolist()
        if func is Tensor.__getitem__ and isinstance(args[1], list):  # PyTorch makes its tensor of indices on meta, too
            args = (args[0], torch.tensor(args[1]))
        if func is Tensor.new_tensor:
            kwargs.setdefault("device", args[0].device)
            kwargs.setdefault("dtype", args[0].dtype)
            func, args = torch.tensor, args[1:]
        if func in (torch.tensor, torch.as_tensor) and not isinstance(args[0], Tensor) and "device" in kwargs:
            return func(*args, **kwargs | {"device": _CPU}).to(kwargs["device"])
        return func(*args, **kwargs)


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


@contextmanager
def elsewhere() -> Iterator[torch.device]:
    """Within it, tensors are made on that device where it is asked for."""
    with nothing_kept(), patch("anystyle.nn.tokens.no_dispatch", nullcontext), _Literals(), _Operations():
        yield DEVICE


@contextmanager
def nothing_kept() -> Iterator[None]:
    """Tensors that are kept a device are not those of before, nor do they stay: several devices read ``meta``."""
    caches = constant, grid_rotary, scaled_waves
    for kept in caches:
        kept.cache_clear()
    yield
    for kept in caches:
        kept.cache_clear()


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    tensors = [leaf for leaf in pytree.tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
    there = any(isinstance(tensor, There) for tensor in tensors)
    device = kwargs.get("device")
    moves = func in (_aten._to_copy.default, _aten.copy_.default)
    strangers = [tensor for tensor in tensors if not isinstance(tensor, There) and tensor.dim()]
    if there and strangers and not moves and func not in (_aten.index.Tensor, _aten.index_put_.default):
        raise RuntimeError(f"{func} of tensors of two devices, {[tuple(tensor.shape) for tensor in tensors]}")
    if isinstance(device, torch.device) and device == DEVICE:
        kwargs = kwargs | {"device": _CPU}
    inside = pytree.tree_map_only(There, lambda tensor: tensor.inner, (args, kwargs))
    result = func(*inside[0], **inside[1])
    stays = device == DEVICE if device is not None else there
    if func == _aten.copy_.default or func.__name__.split(".")[0].endswith("_"):
        return args[0]
    return pytree.tree_map_only(Tensor, lambda tensor: There(tensor) if stays else tensor, result)


def sent(module: torch.nn.Module) -> torch.nn.Module:
    """A module with its tensors there."""
    for part in module.modules():
        for name, value in part._parameters.items():
            if value is not None:
                part._parameters[name] = torch.nn.Parameter(There(value.detach()), requires_grad=False)
        for name, value in part._buffers.items():
            if value is not None:
                part._buffers[name] = There(value)
    return module
