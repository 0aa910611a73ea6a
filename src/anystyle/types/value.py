"""The base of values: frozen dataclasses of tensors that torch can traverse."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from typing import Any, TypeVar

import torch
import torch.utils._pytree as pytree
from torch import Tensor

from anystyle.types.shapes import check_fields


def _flatten(value: Any) -> tuple[list[Any], tuple[str, ...]]:
    names = tuple(item.name for item in fields(value))
    return [getattr(value, name) for name in names], names


def _unflatten(cls: type, children: Any, names: Any) -> Any:
    # Not through the constructor: a pytree may hold leaves that are no tensors for a while.
    value = object.__new__(cls)
    for name, child in zip(names, children, strict=True):
        object.__setattr__(value, name, child)
    return value


AnyValue = TypeVar("AnyValue", bound="Value")


class Value:
    """A frozen dataclass of tensors that torch can traverse as a pytree."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        pytree.register_pytree_node(cls, _flatten, partial(_unflatten, cls))

    def map(self: AnyValue, function: Callable[[Tensor], Tensor]) -> AnyValue:
        """This value with ``function`` applied to every tensor in it."""
        return pytree.tree_map_only(Tensor, function, self)

    def row(self: AnyValue, index: int) -> AnyValue:
        """One row of the batch, as a batch of one."""
        return self.map(lambda tensor: tensor[index : index + 1])

    def to(self: AnyValue, target: torch.device | torch.dtype | str) -> AnyValue:
        """This value on another device, or with its floating-point tensors in another dtype."""
        if isinstance(target, torch.dtype):
            return self.map(lambda tensor: tensor.to(target) if tensor.is_floating_point() else tensor)
        return self.map(lambda tensor: tensor.to(target))

    def detach(self: AnyValue) -> AnyValue:
        """This value without its history of gradients."""
        return self.map(Tensor.detach)

    @classmethod
    def cat(cls: type[AnyValue], values: Sequence[AnyValue], dim: int = 0) -> AnyValue:
        """Values of equal structure joined along an axis of all their tensors; the rest is the first one's."""
        if len(values) == 1:
            return values[0]

        def join(first: Any, *others: Any) -> Any:
            return torch.cat([first, *others], dim) if isinstance(first, Tensor) else first

        return pytree.tree_map(join, *values)

    def expand(self: AnyValue, batch: int) -> AnyValue:
        """This value of one scene seen as ``batch`` equal scenes, without a copy."""
        return self.map(lambda tensor: tensor.expand(batch, *tensor.shape[1:]))


class Given(Value):
    """A value that people make: its tensors have the shapes that it declares, or a UserError says what differs."""

    def __post_init__(self) -> None:
        check_fields(self)
