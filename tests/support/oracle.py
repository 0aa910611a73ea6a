"""The hash fill of the golden files, so that anyone can repeat the parity runs, with other seeds too.

Every golden was computed by the reference implementation whose weights and inputs were filled by this rule; its
``_about`` states the rule in words.
"""

import json
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

GOLDENS = Path(__file__).parents[1] / "goldens"


def golden(name: str) -> dict[str, Any]:
    """One file of ``tests/goldens``."""
    return json.loads((GOLDENS / f"{name}.json").read_text())


def uniform(count: int, index: int) -> np.ndarray:
    """``count`` values in [0, 1), hashed from their place and ``index``, in float64."""
    h = np.arange(1, count + 1, dtype=np.uint32) * np.uint32(2654435761)
    h = h + np.uint32(index * 40503 % 2**32)
    h ^= h >> np.uint32(16)
    h = h * np.uint32(2246822519)
    h ^= h >> np.uint32(13)
    h = h * np.uint32(3266489917)
    h ^= h >> np.uint32(16)
    return h / 2.0**32


def hashed(index: int, shape: Sequence[int], low: float = 0.0, high: float = 1.0) -> Tensor:
    """The input called ``in(index, shape, low, high)``."""
    values = low + (high - low) * uniform(int(np.prod(shape)), index)
    return torch.from_numpy(values.astype(np.float32)).reshape(tuple(shape))


def smooth_image(index: int, shape: Sequence[int]) -> Tensor:
    """The input called ``IMG(index, shape)``: low frequencies with some noise, in [0, 1]."""
    *batch, channels, height, width = shape
    count = int(np.prod(batch))
    low = hashed(index, (count, channels, height // 7, width // 7))
    up = F.interpolate(low, size=(height, width), mode="bilinear", align_corners=False)
    noise = hashed(index + 1, (count, channels, height, width))
    return (0.7 * up + 0.3 * noise).reshape(tuple(shape))


def _bounds(key: str, shape: Sequence[int]) -> tuple[float, float]:
    leaf = key.rsplit(".", 1)[-1]
    if leaf == "running_var":
        return 0.9, 1.1
    if leaf == "gamma":
        return 0.25, 0.75
    if leaf in ("weight", "in_proj_weight") and len(shape) >= 2:
        half = float(np.sqrt(3.0 / np.prod(shape[1:])))
        return -half, half
    if leaf == "weight" and len(shape) == 1:
        return 0.9, 1.1
    return -0.1, 0.1


def fill_sorted(shapes: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Fill rule 1 (``anystyle_golden.json``): the hash index is the place of the reference key among the sorted."""
    filled: dict[str, Tensor] = {}
    for place, key in enumerate(sorted(shapes), start=1):
        like = shapes[key]
        if not like.is_floating_point():
            filled[key] = torch.zeros(like.shape, dtype=like.dtype)
            continue
        low, high = _bounds(key, like.shape)
        filled[key] = hashed(place, like.shape, low, high)
    return filled


def fill_named(shapes: Mapping[str, Tensor], rules: Sequence[Sequence[Any]] = (), offset: int = 0) -> dict[str, Tensor]:
    """Fill rule 2 (all other goldens): the hash index is the CRC-32 of the reference key, plus ``offset``."""
    return {key: _fill_one(key, like, rules, offset) for key, like in shapes.items()}


def _fill_one(key: str, like: Tensor, rules: Sequence[Sequence[Any]], offset: int) -> Tensor:
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
    low, high = spec.get("range", _bounds(key, like.shape))
    scale = spec.get("scale", 1.0)
    return hashed(index, like.shape, low * scale, high * scale)


def assert_matches(actual: Tensor, record: Mapping[str, Any], rtol: float = 1e-4, atol: float = 1e-5) -> None:
    """Compare a tensor with a golden record: shape, norms and samples."""
    if "shape" in record:
        assert list(actual.shape) == record["shape"]
    flat = actual.detach().double().flatten().cpu()
    samples = flat[torch.as_tensor(record["idx"])]
    torch.testing.assert_close(samples, torch.tensor(record["val"], dtype=torch.float64), rtol=rtol, atol=atol)
    for name, value in (("abs_mean", flat.abs().mean()), ("l2", flat.norm())):
        if name in record:
            np.testing.assert_allclose(value.item(), record[name], rtol=rtol, err_msg=name)
