"""Weights that are mapped from a file: pages that a stage is done with go back to the system.

A network read from a file without a copy occupies memory only where it has been looked at. The stages of one pass look
at different parts, so that a model whose parts give their pages back needs room for its largest part, not for the sum.
What a later pass needs comes from the system's file cache, which costs far less than computing with it.
"""

import ctypes
import mmap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from torch import Tensor, nn

_MAPS = Path("/proc/self/maps")
_DONT_NEED = 4
"""``MADV_DONTNEED`` of Linux: the next look at such a page reads it from its file."""


class _Span(NamedTuple):
    """Whole pages of one tensor, and what tells that they are still as in the file."""

    tensor: Tensor
    """Held, so that no other memory can ever take its place."""
    version: int
    start: int
    stop: int


def thrifty(parts: Iterable[nn.Module]) -> int:
    """Let parts of a network give back the pages of their weights after each call.

    Only weights that are frozen, mapped from a file and unchanged since are given back; others stay as they are. Does
    nothing on systems other than Linux.

    Args:
        parts: Modules, each called as a whole.

    Returns:
        How many bytes of weights will be given back.
    """
    mapped = list(_private_files())
    total = 0
    for part in parts:
        spans = [span for tensor in part.parameters() for span in _spans(tensor, mapped)]
        if spans:
            part.register_forward_hook(_Release(spans))
            total += sum(span.stop - span.start for span in spans)
    return total


class _Release:
    """A forward hook that gives pages back."""

    def __init__(self, spans: list[_Span]) -> None:
        self.spans = spans

    def __call__(self, part: nn.Module, inputs: object, output: object) -> None:
        if part.training:
            return
        advise = ctypes.CDLL(None, use_errno=True).madvise
        for span in self.spans:
            # What somebody wrote into is no longer what the file holds.
            if span.tensor._version == span.version and not span.tensor.requires_grad:
                advise(ctypes.c_void_p(span.start), ctypes.c_size_t(span.stop - span.start), _DONT_NEED)

    def __deepcopy__(self, memo: object) -> "_Release":
        """A copy of the network has memory of its own, which belongs to no file."""
        return _Release([])

    def __reduce__(self) -> tuple[type["_Release"], tuple[list[_Span]]]:
        return _Release, ([],)


def _spans(tensor: Tensor, mapped: list[tuple[int, int]]) -> Iterator[_Span]:
    if tensor.device.type != "cpu" or tensor.requires_grad:
        return
    first, last = tensor.data_ptr(), tensor.data_ptr() + tensor.numel() * tensor.element_size()
    # Pages at the borders hold parts of other tensors, which may be in use.
    start, stop = -(-first // mmap.PAGESIZE) * mmap.PAGESIZE, last // mmap.PAGESIZE * mmap.PAGESIZE
    if start < stop and tensor.is_contiguous() and any(low <= first and last <= high for low, high in mapped):
        yield _Span(tensor.detach(), tensor._version, start, stop)


def _private_files() -> Iterator[tuple[int, int]]:
    """The address ranges of this process that are private mappings of files."""
    if not _MAPS.is_file():
        return
    for line in _MAPS.read_text().splitlines():
        addresses, permissions, _, _, inode = line.split()[:5]
        if permissions.endswith("p") and inode != "0":
            low, high = addresses.split("-")
            yield int(low, 16), int(high, 16)
