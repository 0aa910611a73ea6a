"""Comparing values with the shapes and kinds of number that their annotations declare."""

import types
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Union, get_args, get_origin

from jaxtyping import AbstractArray
from torch import Tensor


class ShapeError(ValueError):
    """A value that is not what its annotation declares."""

    def __init__(self, given: str, expected: str) -> None:
        super().__init__(f"given {given}; expected {expected}")
        self.given = given
        self.expected = expected


def check_value(value: object, cls: type, where: str, **sizes: int) -> None:
    """Compare every tensor of a dataclass with the shape and kind of number that the class declares.

    A ShapeError says what ``where`` returned; letters not in ``sizes`` are bound by the first tensor that has them.
    """
    if not isinstance(value, cls):
        raise ShapeError(f"{where} returned {_article(type(value).__name__)}", _article(cls.__name__))
    bound = dict(sizes)
    for item in fields(value):  # pyright: ignore[reportArgumentType]
        _check(getattr(value, item.name), item.type, f"{where}: {cls.__name__}.{item.name}", bound)


def check_tensor(value: object, annotation: Any, where: str, **sizes: int) -> None:
    """Compare one tensor with a jaxtyping annotation; a ShapeError says what is different."""
    _check(value, annotation, where, dict(sizes))


def kind_and_shape(tensor: Tensor) -> str:
    """Such as ``float32 of shape [1, 2, 3]``."""
    return f"{str(tensor.dtype).removeprefix('torch.')} of shape {list(tensor.shape)}"


def _check(value: object, annotation: Any, where: str, bound: dict[str, int]) -> None:
    choices = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    arrays = [choice for choice in choices if isinstance(choice, type) and issubclass(choice, AbstractArray)]
    if not arrays or (value is None and types.NoneType in choices):
        return
    array: Any = arrays[0]
    axes = array.dim_str.split()
    expected = f"{_kind(array)} of shape [{', '.join(_axis(axis, bound) for axis in axes)}]"
    if not isinstance(value, Tensor):
        raise ShapeError(f"{where} is {_article(type(value).__name__)}", expected)
    fits = value.ndim == len(axes) and str(value.dtype).removeprefix("torch.") in array.dtypes
    if not fits or any(
        size != (int(axis) if axis.isdigit() else bound.setdefault(axis, size))
        for axis, size in zip(axes, value.shape, strict=True)
    ):
        raise ShapeError(f"{where} is {kind_and_shape(value)}", expected)


def _axis(axis: str, bound: Mapping[str, int]) -> str:
    return f"{axis}={bound[axis]}" if axis in bound else axis


def _kind(array: Any) -> str:
    floats = "floating-point numbers" if "float32" in array.dtypes else "integers"
    return "booleans" if "bool" in array.dtypes else floats


def _article(name: str) -> str:
    return f"{'an' if name[:1] in 'AEIOUaeiou' else 'a'} {name}"
