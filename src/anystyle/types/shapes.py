"""Frozen dataclasses of tensors that torch can traverse, of the shapes and kinds of number that they declare."""

import functools
import types
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, Union, get_args, get_origin

import torch
import torch.utils._pytree as pytree
from jaxtyping import AbstractArray
from torch import Tensor

from anystyle.errors import UserError


class ShapeError(UserError):
    """A value that is not what its annotation declares."""

    def __init__(self, given: str, expected: str, remedy: str = "") -> None:
        super().__init__(f"given {given}; expected {expected}{remedy and f'; {remedy}'}")
        self.given = given
        self.expected = expected


def check_value(value: object, cls: type, where: str, **sizes: int) -> None:
    """Compare every tensor of a dataclass with the shape and kind of number that the class declares.

    A ShapeError says what ``where`` returned; letters not in ``sizes`` are bound by the first tensor that has them.
    Values inside hold as many scenes and views.
    """
    if not isinstance(value, cls):
        raise ShapeError(f"{where} returned {_article(type(value).__name__)}", _article(cls.__name__))
    check_fields(value, f"{where}: ", **sizes)


def check_fields(value: Any, where: str = "", **sizes: int) -> None:
    """Compare every tensor of a dataclass with its annotation; messages begin with ``where``."""
    bound = dict(sizes)
    for item in fields(value):
        part, name = getattr(value, item.name), f"{where}{type(value).__name__}.{item.name}"
        _check(part, item.type, name, bound)
        if is_dataclass(part):
            check_fields(part, f"{name}: ", **{axis: bound[axis] for axis in ("B", "V") if axis in bound})


def check_tensor(value: object, annotation: Any, where: str, **sizes: int) -> None:
    """Compare one tensor with a jaxtyping annotation; a ShapeError says what is different."""
    _check(value, annotation, where, dict(sizes))


def kind_and_shape(tensor: Tensor) -> str:
    """Such as ``float32 of shape [1, 2, 3]``."""
    return f"{str(tensor.dtype).removeprefix('torch.')} of shape {list(tensor.shape)}"


def _check(value: object, annotation: Any, where: str, bound: dict[str, int]) -> None:
    array, optional = _declared(annotation)
    if array is None or (value is None and optional):
        return
    axes = array.dim_str.split()
    shape = ", ".join(f"{axis}={bound[axis]}" if axis in bound else axis for axis in axes)
    expected = f"{_kind(array)} of shape [{shape}]"
    if not isinstance(value, Tensor):
        raise ShapeError(f"{where} is {_article(type(value).__name__)}", expected, "torch.as_tensor makes one")
    fits = value.ndim == len(axes) and str(value.dtype).removeprefix("torch.") in array.dtypes
    if not fits or any(
        size != (int(axis) if axis.isdigit() else bound.setdefault(axis, size))
        for axis, size in zip(axes, value.shape, strict=True)
    ):
        raise ShapeError(f"{where} is {kind_and_shape(value)}", expected, _remedy(value, axes))


@functools.cache
def _declared(annotation: Any) -> tuple[Any, bool]:
    """The array that an annotation declares, if there is one, and whether it may be left out."""
    choices = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    arrays = [choice for choice in choices if isinstance(choice, type) and issubclass(choice, AbstractArray)]
    return (arrays[0] if arrays else None), types.NoneType in choices


def _remedy(value: Tensor, axes: Sequence[str]) -> str:
    """What makes the tensor fit, for the usual slips."""
    is_image, given = axes[-3:-2] == ["3"], list(value.shape)
    if is_image and value.dtype == torch.uint8:
        return "levels of 8 bits are divided: .float() / 255"
    if is_image and value.ndim >= 3 and given[-3] != 3 and given[-1] in (1, 3, 4):
        return "colours come before the rows: [..., :3].movedim(-1, -3)"
    return "the first axis, of scenes, is missing: [None]" if value.ndim == len(axes) - 1 else ""


def _kind(array: Any) -> str:
    floats = "floating-point numbers" if "float32" in array.dtypes else "integers"
    return "booleans" if "bool" in array.dtypes else floats


def _article(name: str) -> str:
    return f"{'an' if name[:1] in 'AEIOUaeiou' else 'a'} {name}"


def _flatten(value: Any) -> tuple[list[Any], tuple[str, ...]]:
    names = tuple(item.name for item in fields(value))
    return [getattr(value, name) for name in names], names


def _unflatten(cls: type, children: Any, names: Any) -> Any:
    # Not through the constructor: a pytree may hold other leaves than tensors for a while.
    value = object.__new__(cls)
    for name, child in zip(names, children, strict=True):
        object.__setattr__(value, name, child)
    return value


AnyValue = TypeVar("AnyValue", bound="Value")


class Value:
    """A frozen dataclass of tensors that torch can traverse as a pytree."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        pytree.register_pytree_node(cls, _flatten, functools.partial(_unflatten, cls))

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

    def pin_memory(self: AnyValue) -> AnyValue:
        """This value where a card copies it from without the processor, as a loader of batches asks for."""
        return self.map(Tensor.pin_memory)

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
