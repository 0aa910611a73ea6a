"""Oracles of published networks: weights and inputs filled by a hash, and records of what comes out.

Where no weights can be had, or a file of gigabytes is too much for a test, both networks, the published and one's own,
are filled by the same rule, which depends on the names of tensors alone. What the published one computes is recorded
once; one's own must give the same numbers. The rule can be repeated in any language: all integers are modulo 2**32,
``h = j * 2654435761 + i * 40503; h ^= h >> 16; h *= 2246822519; h ^= h >> 13; h *= 3266489917; h ^= h >> 16`` for the
``j``-th value from 1 on of index ``i``, and the value is ``h / 2**32``.
"""

import re
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor


def uniform(count: int, index: int) -> NDArray[np.float64]:
    """``count`` values in [0, 1), hashed from their place and ``index``.

    Example:
        >>> uniform(3, 7).round(6).tolist()
        [0.547416, 0.180499, 0.592983]
    """
    h = np.arange(1, count + 1, dtype=np.uint32) * np.uint32(2654435761)
    h = h + np.uint32(index * 40503 % 2**32)
    h ^= h >> np.uint32(16)
    h = h * np.uint32(2246822519)
    h ^= h >> np.uint32(13)
    h = h * np.uint32(3266489917)
    h ^= h >> np.uint32(16)
    return h / 2.0**32


def hashed(index: int, shape: Sequence[int], low: float | int = 0.0, high: float | int = 1.0) -> Tensor:
    """A float32 tensor of values in [low, high) by the hash."""
    values = low + (high - low) * uniform(int(np.prod(shape)), index)
    return torch.from_numpy(values.astype(np.float32)).reshape(tuple(shape))


def smooth_image(index: int, shape: Sequence[int]) -> Float[Tensor, "*batch C H W"]:
    """Images in [0, 1] of low frequencies with some noise; both sides are at least 7 pixels."""
    *batch, channels, height, width = shape
    count = int(np.prod(batch))
    low = hashed(index, (count, channels, height // 7, width // 7))
    up = F.interpolate(low, size=(height, width), mode="bilinear", align_corners=False)
    return (0.7 * up + 0.3 * hashed(index + 1, (count, channels, height, width))).reshape(tuple(shape))


def fill_named(shapes: Mapping[str, Tensor], rules: Sequence[Sequence[Any]] = (), offset: int = 0) -> dict[str, Tensor]:
    """Weights for a state dict: each tensor is hashed from the CRC-32 of its name, plus ``offset``.

    Values are in [-a, a), ``a = sqrt(3 / fan-in)``, for matrices and kernels, in [0.9, 1.1) for weights of norms and
    running variances, in [0.25, 0.75) for ``gamma``, in [-0.1, 0.1) otherwise, and 0 for integers.

    Args:
        shapes: Tensors by name, of which only shapes and dtypes are read; a module's ``state_dict()``.
        rules: Pairs of a regular expression and what the first match gives a tensor instead: ``{"scale": s}``
            multiplies both ends, ``{"range": [low, high]}`` replaces them, ``{"const": c}`` is one value, and
            ``{"center": [...], "half": h}`` is that tensor, plus or minus up to ``h``.
        offset: Another seed.
    """
    return {key: _filled(key, like, rules, offset) for key, like in shapes.items()}


def _filled(key: str, like: Tensor, rules: Sequence[Sequence[Any]], offset: int) -> Tensor:
    if not like.is_floating_point():
        return torch.zeros(like.shape, dtype=like.dtype)
    index = (zlib.crc32(key.encode()) + offset) % 2**32
    spec: Mapping[str, Any] = next((spec for pattern, spec in rules if re.search(pattern, key)), {})
    if "const" in spec:
        return torch.full(like.shape, float(spec["const"]))
    if "center" in spec:
        half = spec["half"]
        noise = -half + 2 * half * uniform(like.numel(), index).reshape(tuple(like.shape))
        return torch.from_numpy((np.asarray(spec["center"], dtype=np.float64) + noise).astype(np.float32))
    low, high = spec.get("range", bounds(key, like.shape))
    scale = spec.get("scale", 1.0)
    return hashed(index, like.shape, low * scale, high * scale)


def bounds(key: str, shape: Sequence[int]) -> tuple[float, float]:
    """Between which values a tensor is filled, by its name and shape."""
    leaf = key.rsplit(".", 1)[-1]
    if leaf == "running_var":
        return 0.9, 1.1
    if leaf == "gamma":
        return 0.25, 0.75
    if leaf in ("weight", "in_proj_weight") and len(shape) >= 2:
        half = float(np.sqrt(3.0 / np.prod(shape[1:])))
        return -half, half
    return (0.9, 1.1) if leaf == "weight" and len(shape) == 1 else (-0.1, 0.1)


def record(tensor: Tensor, samples: int = 24) -> dict[str, Any]:
    """What is written of a tensor: its shape, norms, and evenly spaced values; it can be stored as JSON.

    Example:
        >>> record(torch.tensor([[3.0, -4.0]]), samples=2)
        {'shape': [1, 2], 'abs_mean': 3.5, 'l2': 5.0, 'idx': [0, 1], 'val': [3.0, -4.0]}
    """
    flat = tensor.detach().double().flatten().cpu()
    places = torch.linspace(0, len(flat) - 1, min(samples, len(flat))).round().long()
    sums = {"abs_mean": flat.abs().mean().item(), "l2": flat.norm().item()}
    return {"shape": list(tensor.shape), **sums, "idx": places.tolist(), "val": flat[places].tolist()}


def assert_matches(actual: Tensor, expected: Mapping[str, Any], rtol: float = 1e-4, atol: float = 1e-5) -> None:
    """Compare a tensor with a record: its shape, norms and samples.

    Raises:
        AssertionError: They differ by more than ``atol + rtol * |recorded|``, or norms by more than ``rtol``.
    """
    if "shape" in expected:
        assert list(actual.shape) == expected["shape"], f"{list(actual.shape)} instead of {expected['shape']}"
    flat = actual.detach().double().flatten().cpu()
    samples = flat[torch.as_tensor(expected["idx"])]
    torch.testing.assert_close(samples, torch.tensor(expected["val"], dtype=torch.float64), rtol=rtol, atol=atol)
    for name, value in (("abs_mean", flat.abs().mean()), ("l2", flat.norm())):
        if name in expected:
            np.testing.assert_allclose(value.item(), expected[name], rtol=rtol, err_msg=name)
