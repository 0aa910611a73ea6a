"""What a network said of an image, kept for the next metric that asks.

A protocol shows the same photographs in every style, and several metrics look at the same images with the same
network. Entries are found by an image's content, not by the tensor that holds it: it does not matter who loaded it, and
an image that was changed is another image.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import count
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor, nn

Key = tuple[object, ...]
Compute = Callable[[Tensor], Sequence[Tensor]]
"""From images ``M 3 H W`` to any number of tensors whose first axis is ``M``."""

LIMIT = 1 << 30
"""Bytes that are kept; the least recently used go first."""

PIXELS = 1 << 20
"""How many pixels a network is shown at once."""

CPU_PIXELS = 1 << 18
"""The same on a processor: what features of more images take is slow to get from the system, and in no cache."""


class Memo:
    """A bounded memory of results by image.

    Args:
        limit: Bytes to keep.
    """

    def __init__(self, limit: int = LIMIT) -> None:
        self.limit = limit
        self._kept: OrderedDict[Key, tuple[Tensor, ...]] = OrderedDict()
        self._bytes = 0

    def rows(self, images: Float[Tensor, "M C H W"], marks: Sequence[str], what: Key, compute: Compute) -> list[Tensor]:
        """What ``compute`` gives for each image; it sees an image once.

        Args:
            images: To be looked at; without gradients.
            marks: Of :func:`fingerprints`, one an image.
            what: What is computed: whatever the result depends on beside the image.
            compute: Of images that differ from each other.
        """
        keys = [(*what, mark, str(images.device), images.dtype) for mark in marks]
        found = {key: self._kept[key] for key in keys if key in self._kept}
        places = {key: place for place, key in reversed(list(enumerate(keys))) if key not in found}
        order = sorted(places, key=lambda key: places[key])
        together = batch_of(images)
        for start in range(0, len(order), together):
            part = order[start : start + together]
            results = compute(images[[places[key] for key in part]])
            for row, key in enumerate(part):
                found[key] = tuple(result[row].clone() for result in results)
        for key in dict.fromkeys(keys):
            self._keep(key, found[key])
        columns = zip(*(found[key] for key in keys), strict=True)
        return [torch.stack(column) for column in columns]

    def values(
        self, marks: Sequence[object], what: Key, like: Tensor, compute: Callable[[], Float[Tensor, " M"]]
    ) -> Float[Tensor, " M"]:
        """One number for each mark; computed together, unless all are known.

        Args:
            marks: One a number, such as the fingerprints of two images that are compared.
            what: What is computed.
            like: On the device and in the precision of the numbers.
            compute: Gives all of them.
        """
        keys = [(*what, mark, str(like.device), like.dtype) for mark in marks]
        if not all(key in self._kept for key in keys):
            for key, value in zip(keys, compute().detach(), strict=True):
                self._keep(key, (value.clone(),))
        return torch.stack([self._kept[key][0] for key in keys])

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()
        self._bytes = 0

    def _keep(self, key: Key, value: tuple[Tensor, ...]) -> None:
        if key in self._kept:
            self._kept.move_to_end(key)
            return
        self._kept[key] = value
        self._bytes += _size(value)
        while self._bytes > self.limit:
            _, dropped = self._kept.popitem(last=False)
            self._bytes -= _size(dropped)


MEMO = Memo()
"""What this process remembers."""


def fingerprints(images: Float[Tensor, "M C H W"]) -> list[str]:
    """A mark for each image, equal where size and content are; one row stands for all of an expanded tensor."""
    if images.shape[0] > 1 and images.stride(0) == 0:
        return fingerprints(images[:1]) * images.shape[0]
    rows = images.detach().cpu().contiguous()
    shape = str(tuple(rows.shape[1:])).encode()
    return [hashlib.blake2b(row.numpy().data, digest_size=16, key=shape[:64]).hexdigest() for row in rows]


def batch_of(images: Float[Tensor, "M C H W"]) -> int:
    """How many images of this size are looked at together."""
    pixels = CPU_PIXELS if images.device.type == "cpu" else PIXELS
    return max(1, pixels // max(1, images.shape[-1] * images.shape[-2]))


def _size(value: tuple[Tensor, ...]) -> int:
    return sum(tensor.nbytes for tensor in value)


_NUMBERED: "WeakKeyDictionary[nn.Module, int]" = WeakKeyDictionary()
_NUMBERS = count()


def identity(network: nn.Module) -> str:
    """The same for the same module with the same weights, in this process."""
    number = _NUMBERED.setdefault(network, -1)
    if number < 0:
        number = _NUMBERED[network] = next(_NUMBERS)
    versions = [tensor._version for tensor in (*network.parameters(), *network.buffers()) if not tensor.is_inference()]
    return f"{number}:{sum(versions)}"
