"""Features of images, kept for the next metric that needs them.

A protocol shows the same photographs in every style, and several metrics run the same network on the same images.
Entries are found by an image's content, not by the tensor that holds it.
"""

from collections.abc import Callable, Sequence
from itertools import count
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.io.cache import LRUCache

Key = tuple[object, ...]
Compute = Callable[[Tensor], Sequence[Tensor]]
"""From images ``M 3 H W`` to any number of tensors whose first axis is ``M``."""

PIXELS = 1 << 20
"""Pixels that a network processes at once."""
CPU_PIXELS = 1 << 18
"""The same on a CPU, where larger activations are slow to allocate and fit no cache."""


class FeatureCache:
    """Results of frozen networks by image, up to ``limit`` bytes; the least recently used go first."""

    def __init__(self, limit: int = 1 << 30) -> None:
        self._entries: LRUCache[Key, tuple[Tensor, ...]] = LRUCache(limit, lambda each: sum(t.nbytes for t in each))

    def __len__(self) -> int:
        return len(self._entries)

    def features(self, images: Float[Tensor, "M C H W"], key: Key, compute: Compute) -> list[Tensor]:
        """What ``compute`` returns for each distinct image, stacked; not to be written to.

        The ``key`` is everything else that the result depends on: network, weights, size.
        """
        keys = [(*key, str(images.device), images.dtype, digest) for digest in digests(images)]
        results = {entry: self._entries[entry] for entry in keys if entry in self._entries}
        new = sorted({entry: index for index, entry in enumerate(keys) if entry not in results}.values())
        size = batch_size(images)
        for batch in (new[start : start + size] for start in range(0, len(new), size)):
            outputs = compute(images[batch])
            for row, index in enumerate(batch):
                # A row of several would keep them all in memory.
                results[keys[index]] = tuple(o[row].clone() if len(batch) > 1 else o[row] for o in outputs)
        for entry in dict.fromkeys(keys):
            self._entries[entry] = results[entry]
        columns = zip(*(results[entry] for entry in keys), strict=True)
        return [torch.stack(column) if len(keys) > 1 else column[0][None] for column in columns]

    def clear(self) -> None:
        """Forget everything."""
        self._entries.clear()


CACHE = FeatureCache()
"""Process-wide cache."""


def digests(images: Float[Tensor, " M *shape"]) -> list[str]:
    """A hash of each row, equal where shape and content are; one stands for all rows of an expanded tensor.

    Python's own, of 64 bits and another in each process: four times as fast as one that could be stored.
    """
    if images.shape[0] > 1 and images.stride(0) == 0:
        return digests(images[:1]) * images.shape[0]
    rows = images.detach().cpu().contiguous()
    # As bytes, for NumPy has no bfloat16.
    return [f"{tuple(row.shape)} {hash(row.flatten().view(torch.uint8).numpy().tobytes())}" for row in rows]


def batch_size(images: Float[Tensor, "M C H W"]) -> int:
    """How many images of this size a network processes at once."""
    pixels = CPU_PIXELS if images.device.type == "cpu" else PIXELS
    return max(1, pixels // max(1, images.shape[-1] * images.shape[-2]))


_NUMBERS: "WeakKeyDictionary[nn.Module, int]" = WeakKeyDictionary()
_NEXT = count()


def identity(network: nn.Module) -> str:
    """The same for the same module with the same weights, in this process; a new one at every call if any can learn.

    Fused optimisers do not raise PyTorch's version counter, so that a step of theirs would not be seen.
    """
    weights = [*network.parameters(), *network.buffers()]
    if network not in _NUMBERS or any(tensor.requires_grad for tensor in weights):
        _NUMBERS[network] = next(_NEXT)
    return f"{_NUMBERS[network]}:{sum(tensor._version for tensor in weights if not tensor.is_inference())}"
