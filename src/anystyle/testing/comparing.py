"""How tensors are held against a contract: shapes by their annotations, numbers by what rounding leaves of them."""

import pickle
from collections.abc import Iterator, Mapping, Sized
from dataclasses import fields
from typing import Any, TypeVar

import torch
import torch.utils._pytree as pytree
from torch import Tensor

from anystyle.testing.check import ContractError, attempt, expect
from anystyle.testing.subject import Subject
from anystyle.types import Value
from anystyle.types.shapes import ShapeError, check_tensor, check_value


def conform(value: object, cls: type, where: str, **sizes: int) -> None:
    """Hold a dataclass of a plugin against its annotations; see :func:`anystyle.types.shapes.check_value`."""
    change = f"return {cls.__name__}(...) from there, with the shapes of its docstring in `anystyle.types`"
    try:
        check_value(value, cls, where, **sizes)
    except ShapeError as error:
        raise ContractError(given=error.given, expected=error.expected, change=change) from None


def conform_tensor(value: object, annotation: Any, where: str, **sizes: int) -> None:
    """Hold one tensor against a jaxtyping annotation."""
    change = "check the order and number of its axes, and its dtype, where it is made"
    try:
        check_tensor(value, annotation, where, **sizes)
    except ShapeError as error:
        raise ContractError(given=error.given, expected=error.expected, change=change) from None


def tensors_of(value: Any) -> dict[str, Tensor]:
    """Every tensor of a value by its path, such as ``attributes.opacity``."""
    leaves, _ = pytree.tree_flatten_with_path(_plain(value))
    return {".".join(str(getattr(key, "key", key)) for key in path): leaf for path, leaf in leaves}


def expect_finite(value: Any, where: str) -> None:
    """Refuse NaN and infinity in any tensor of a value."""
    for name, tensor in tensors_of(value).items():
        bad = int((~torch.isfinite(tensor)).sum()) if tensor.is_floating_point() else 0
        expect(
            bad == 0,
            given=f"{bad} of the {tensor.numel()} numbers of {_path(where, name)} are NaN or infinite",
            expected="finite numbers",
            change="look for a division by zero, a logarithm or root of a negative number, or an exponential that "
            "overflows",
        )


def expect_same(value: Any, other: Any, *, what: str, change: str, expected: str = "the same bits") -> None:
    """Refuse any difference, however small, between two values."""
    ours, theirs = tensors_of(value), tensors_of(other)
    for name, tensor in theirs.items():
        same = name in ours and _is_same(ours[name], tensor)
        size = _difference(ours[name], tensor) if name in ours else "it is absent"
        expect(same, given=f"{_path(what, name)}: {size}", expected=expected, change=change)


def expect_untouched(value: Any, before: Any, what: str) -> None:
    """Refuse that a call wrote into a value that it was given."""
    change = "replace operations that end in '_', or write into a slice, by ones that make a new tensor"
    expect_same(value, before, what=what, expected="unchanged tensors", change=change)


def expect_close(value: Any, other: Any, *, what: str, change: str, tolerance: float = 1e-3) -> None:
    """Refuse differences beyond rounding: more than ``tolerance`` of the largest number of each tensor."""
    ours, theirs = tensors_of(value), tensors_of(other)
    for name, tensor in theirs.items():
        here = ours.get(name)
        close = here is not None and here.shape == tensor.shape and _is_close(here, tensor, tolerance)
        size = "it is absent" if here is None else _difference(here, tensor)
        expect(close, given=f"{_path(what, name)}: {size}", expected="equal numbers, but for rounding", change=change)


def expect_gradient(gradient: Tensor | None, where: str, *, change: str) -> None:
    """Refuse a gradient that is missing, 0 everywhere, or not finite."""
    usable = gradient is not None and bool(gradient.any()) and bool(gradient.isfinite().all())
    flaw = "missing" if gradient is None else "NaN or infinite somewhere" if bool(gradient.any()) else "0 everywhere"
    expect(
        usable, given=f"the gradient in {where} is {flaw}", expected="finite numbers that are not all 0", change=change
    )


def _is_same(tensor: Tensor, other: Tensor) -> bool:
    # NaN is like NaN here: that numbers are finite is a promise of its own, and reported once.
    return tensor.shape == other.shape and torch.allclose(tensor, other, rtol=0, atol=0, equal_nan=True)


def _is_close(tensor: Tensor, other: Tensor, tolerance: float) -> bool:
    if tensor.numel() == 0:
        return True
    a, b = tensor.detach().double(), other.detach().double()
    limit = tolerance * max(1e-6, float(b.nan_to_num(0, 0, 0).abs().max()))
    return torch.allclose(a, b, rtol=tolerance, atol=limit, equal_nan=True)


def _difference(tensor: Tensor, other: Tensor) -> str:
    if tensor.shape != other.shape:
        return f"shape {list(tensor.shape)} against {list(other.shape)}"
    gap = (tensor.detach().double() - other.detach().double()).abs()
    differing = int((gap != 0).sum())
    return f"{differing} of {gap.numel()} numbers differ, by up to {float(gap.max()):.3g}" if gap.numel() else "empty"


def _plain(value: Any) -> Any:
    # Values flatten without names of their fields; as dictionaries they have them.
    if isinstance(value, Tensor) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(name): plain for name, item in value.items() if (plain := _plain(item)) is not None}
    if isinstance(value, (list, tuple)):
        return _plain(dict(enumerate(value)))
    if isinstance(value, Value):
        return _plain({item.name: getattr(value, item.name) for item in fields(value)})  # pyright: ignore[reportArgumentType]
    return None


def _path(where: str, name: str) -> str:
    return f"{where} ({name})" if name else where


Source = TypeVar("Source", bound=Sized)

MOST = 3
"""Scenes or styles that are looked at; a source may have thousands."""


def expect_any(source: Sized, what: str) -> None:
    """Refuse a source that has nothing."""
    expect(
        len(source) >= 1,
        given=f"no {what}",
        expected="at least one",
        change="raise a ValueError in the constructor where the folder is empty, or return a sample from `example`",
    )


def expect_srgb(images: Tensor, where: str) -> None:
    """Refuse pixels that are not float32 sRGB in [0, 1] on the CPU."""
    low, high = float(images.min()), float(images.max())
    expect(
        low >= 0 and high <= 1 and images.device.type == "cpu" and images.dtype == torch.float32,
        given=f"{where}: {images.dtype} images from {low:.3g} to {high:.3g} on {images.device}",
        expected="float32 sRGB in [0, 1] on the CPU",
        change="divide 8-bit values by 255",
    )


def copies(plugin: Subject[Source]) -> Iterator[tuple[str, Source]]:
    """The source itself, its copy in a worker, and a new instance."""
    source = plugin.instance
    with attempt("pickling the source", change="open files when they are read, and keep no handles or generators"):
        copied = pickle.loads(pickle.dumps(source))
    yield from (("this source", source), ("a pickled copy", copied), ("a new instance", plugin.build(seed=1)))
