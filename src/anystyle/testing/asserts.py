"""Assertions that several contracts share."""

import pickle
from collections.abc import Iterator, Mapping, Sized
from dataclasses import fields
from typing import Any, TypeVar

import torch
from torch import Tensor

from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Value

_Source = TypeVar("_Source", bound=Sized)

ONE_LINE = r"\A.+\Z"
"""Matches error messages of one line."""


def tensors_of(value: Any, path: str = "") -> dict[str, Tensor]:
    """Every tensor of a value by its path, such as ``attributes.opacity``."""
    if isinstance(value, Tensor):
        return {path: value}
    if isinstance(value, Value):
        value = {item.name: getattr(value, item.name) for item in fields(value)}  # pyright: ignore[reportArgumentType]
    elif isinstance(value, list | tuple):
        value = dict(enumerate(value))
    items = value.items() if isinstance(value, Mapping) else ()
    paths = ((f"{path}.{key}" if path else str(key), item) for key, item in items)
    return {name: leaf for inner, item in paths for name, leaf in tensors_of(item, inner).items()}


def finite(value: Any, what: str) -> None:
    """Refuse NaN and infinity in any tensor of a value."""
    for name, tensor in tensors_of(value).items():
        assert bool(torch.isfinite(tensor).all()), f"{what}: numbers of `{name}` are NaN or infinite"


def same(value: Any, other: Any, what: str, tolerance: float = 0.0) -> None:
    """Refuse differences of more than ``tolerance`` times the largest number of each tensor; by default, any."""
    values = tensors_of(value)
    for name, tensor in tensors_of(other).items():
        assert name in values, f"{what}: `{name}` is absent"
        mine, theirs = values[name].detach().double(), tensor.detach().double()
        assert mine.shape == theirs.shape, f"{what}: `{name}` has shape {list(mine.shape)}, not {list(theirs.shape)}"
        largest = float(theirs.nan_to_num(0, 0, 0).abs().max()) if theirs.numel() else 0.0
        equal = torch.allclose(mine, theirs, tolerance, tolerance * max(largest, 1e-6), equal_nan=True)
        assert equal, f"{what}: `{name}` differs by up to {float((mine - theirs).abs().max()):.3g}"


def close(value: Any, other: Any, what: str, tolerance: float = 1e-3) -> None:
    """Refuse differences that are larger than rounding."""
    same(value, other, what, tolerance)


def gradient(gradient: Tensor | None, what: str) -> None:
    """Refuse a gradient that is missing, 0 everywhere, or not finite."""
    assert gradient is not None and bool(gradient.any()), f"no gradient reaches {what}; is it unused or detached?"
    assert bool(gradient.isfinite().all()), f"the gradient in {what} is NaN or infinite somewhere"


def cameras(cameras: Cameras, size: tuple[int, int]) -> None:
    """Refuse cameras that are not rigid pinholes of images of ``size``, height and width."""
    assert tuple(cameras.size) == tuple(size), f"cameras of size {cameras.size} for images of {size}"
    rotation, last = cameras.world_from_camera[..., :3, :3], cameras.world_from_camera[..., 3, :]
    error = float((rotation @ rotation.mT - torch.eye(3)).abs().max())
    rigid = error < 1e-3 and bool((torch.linalg.det(rotation) > 0).all())
    assert rigid, f"poses that are not rotations: R R^T differs from the identity by up to {error:.2g}"
    assert bool((last == torch.tensor([0.0, 0.0, 0.0, 1.0])).all()), "poses whose last row is not 0 0 0 1"
    focal, bottom = cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2], cameras.intrinsics[..., 2, :]
    valid = bool((focal > 0).all() & (bottom == torch.tensor([0.0, 0.0, 1.0])).all())
    assert valid, "intrinsics that are not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths in pixels"
    center = cameras.intrinsics[..., :2, 2] / torch.tensor([size[1], size[0]])
    inside = bool(((center > 0.1) & (center < 0.9)).all())
    assert inside, f"a principal point at {center.flatten(0, -2)[0].tolist()} of width and height; give it in pixels"


def srgb(images: Tensor, what: str) -> None:
    """Refuse pixels that are not float32 sRGB in [0, 1] on the CPU."""
    low, high = float(images.min()), float(images.max())
    valid = low >= 0 and high <= 1 and images.device.type == "cpu" and images.dtype == torch.float32
    assert valid, f"{what}: {images.dtype} from {low:.3g} to {high:.3g} on {images.device}, not float32 in [0, 1]"


def copies(plugin: Subject[_Source]) -> Iterator[tuple[str, _Source]]:
    """The source itself, its copy in a worker, and a new instance."""
    source = plugin.instance
    yield "this source", source
    yield "a pickled copy", pickle.loads(pickle.dumps(source))
    yield "a new instance", plugin.build(seed=1)
