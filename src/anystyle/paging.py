"""Weights that are mapped from a file: pages that a stage is done with go back to the system.

A network read from a file without a copy occupies memory only where it has been looked at. The stages of one pass look
at different parts, so that a model whose parts give their pages back needs room for its largest part, not for the sum.
What a later pass needs comes from the system's file cache, which costs far less than computing with it. The same holds
while loading: once a tensor has been brought to another type, the page it was read from is of no more use.

Only pages that still are the file's own are ever given back. The kernel says which these are; a page that somebody
wrote into is the process's own, and stays.
"""

import ctypes
import mmap
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

_MAPS = Path("/proc/self/maps")
_PAGES = Path("/proc/self/pagemap")
_DONT_NEED = 4
"""``MADV_DONTNEED`` of Linux: the next look at such a page reads it from its file."""
_WORTH_IT = 1 << 20
"""Bytes; less than that stays."""
_PRESENT, _SWAPPED, _OF_FILE = (np.uint64(1 << bit) for bit in (63, 62, 61))
"""Bits of an entry of ``/proc/self/pagemap``."""


class _Span(NamedTuple):
    """Whole pages of one tensor."""

    tensor: Tensor
    """Held, so that no other memory can ever take its place."""
    start: int
    stop: int


def thrifty(parts: Iterable[nn.Module]) -> int:
    """Let parts of a network, and the blocks in them, give back the pages of their weights after each call.

    Only weights that are frozen, mapped from a file and unchanged since are given back; others stay as they are. A part
    that is moved to another device gives all of its pages back at its first call there. Does nothing on systems other
    than Linux.

    Args:
        parts: Modules, each called as a whole.

    Returns:
        How many bytes of weights will be given back.
    """
    mapped = list(_private_files())
    total = 0
    for part in parts:
        lists = [module for module in part.modules() if isinstance(module, nn.ModuleList)]
        # A block that is never called as a module gives its pages back with the whole.
        for unit in (part, *(block for blocks in lists for block in blocks)):
            spans = list(_spans(unit, mapped))
            size = sum(span.stop - span.start for span in spans)
            if size >= _WORTH_IT:
                unit.register_forward_hook(_Release(spans))
                total += size if unit is part else 0
    return total


def _spans(module: nn.Module, mapped: Sequence[tuple[int, int]]) -> Iterator[_Span]:
    for tensor in module.parameters():
        span = None if tensor.requires_grad else _span(tensor)
        if span is not None and any(low <= span.start and span.stop <= high for low, high in mapped):
            yield span


def brought(tensor: Tensor, dtype: torch.dtype) -> Tensor:
    """A tensor in another type, itself if it has it; pages of a file that it was read from are given back."""
    if tensor.dtype == dtype:
        return tensor
    converted = tensor.to(dtype)
    give_back(tensor)
    return converted


def give_back(tensor: Tensor) -> None:
    """Give back those pages of a tensor that still are a file's: its values stay, and are read again when looked at."""
    if (span := _span(tensor)) is not None:
        _give_back([span])


@torch.no_grad()
def fill(module: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Give a module values, tensor by tensor, so that there never is a second copy of more than one.

    A module on the meta device has no memory to copy into: it takes the tensors themselves, those of another type
    brought to its own. Pages of a file that values were copied from are given back.

    Args:
        module: Keeps the types it has.
        state: Values of all of its state dict or of a part, keys and shapes as there.
    """
    own = module.state_dict()
    if any(tensor.is_meta for tensor in own.values()):
        taken = {key: brought(tensor, own[key].dtype) for key, tensor in state.items()}
        module.load_state_dict(own | taken, assign=True)
        return
    for key, tensor in state.items():
        own[key].copy_(tensor)
        give_back(tensor)


class _Release:
    """A forward hook that gives pages back."""

    def __init__(self, spans: list[_Span]) -> None:
        self.spans = spans

    def __call__(self, part: nn.Module, inputs: object, output: object) -> None:
        if part.training or not self.spans:
            return
        _give_back(self.spans)
        if all(parameter.device.type != "cpu" for parameter in part.parameters()):
            self.spans = []

    def __deepcopy__(self, memo: object) -> "_Release":
        """A copy of the network has memory of its own, which belongs to no file."""
        return _Release([])

    def __reduce__(self) -> tuple[type["_Release"], tuple[list[_Span]]]:
        return _Release, ([],)


def _give_back(spans: Iterable[_Span]) -> None:
    if not _PAGES.is_file():
        return
    advise = ctypes.CDLL(None, use_errno=True).madvise
    with _PAGES.open("rb", buffering=0) as pages:
        for span in spans:
            if _is_of_file(pages.fileno(), span):
                advise(ctypes.c_void_p(span.start), ctypes.c_size_t(span.stop - span.start), _DONT_NEED)


def _is_of_file(pages: int, span: _Span) -> bool:
    """Whether every page that is in memory is still as in its file, and none was swapped out."""
    count = (span.stop - span.start) // mmap.PAGESIZE
    try:
        read = os.pread(pages, 8 * count, span.start // mmap.PAGESIZE * 8)
    except OSError:
        return False
    entries = np.frombuffer(read, dtype=np.uint64)
    written = (entries & _PRESENT != 0) & (entries & _OF_FILE == 0)
    return len(entries) == count and not (written | (entries & _SWAPPED != 0)).any()


def _span(tensor: Tensor) -> _Span | None:
    """The whole pages in a tensor; those at its borders hold parts of others, which may be in use."""
    if tensor.device.type != "cpu" or not tensor.is_contiguous():
        return None
    first, last = tensor.data_ptr(), tensor.data_ptr() + tensor.numel() * tensor.element_size()
    start, stop = -(-first // mmap.PAGESIZE) * mmap.PAGESIZE, last // mmap.PAGESIZE * mmap.PAGESIZE
    return _Span(tensor.detach(), start, stop) if start < stop else None


def _private_files() -> Iterator[tuple[int, int]]:
    """The address ranges of this process that are private mappings of files."""
    if not _MAPS.is_file():
        return
    for line in _MAPS.read_text().splitlines():
        addresses, permissions, _, _, inode = line.split()[:5]
        if permissions.endswith("p") and inode != "0":
            low, high = addresses.split("-")
            yield int(low, 16), int(high, 16)
