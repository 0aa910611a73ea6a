"""The memory of a pass, estimated before it is run: tensors without memory are followed through the network.

Fake tensors compute shapes alone. Every tensor the network makes is counted from birth to death, so the largest sum is
what the pass itself will hold beside the weights; two sizes tell the slope, for memory is linear in the views.
"""

import contextlib
import copy
import logging
import threading
import weakref
from collections.abc import Callable, Sequence
from typing import NamedTuple

import psutil
import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import (
    DataDependentOutputException,
    DynamicOutputShapeException,
    FakeTensorMode,
    UnsupportedOperatorException,
)
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

from anystyle import capacity
from anystyle.capacity import USABLE, gib
from anystyle.contracts import Backbone
from anystyle.types import Tokens

_log = logging.getLogger(__name__)

_ASKS_FOR_VALUES = (DataDependentOutputException, DynamicOutputShapeException, UnsupportedOperatorException)

PLENTY = 16 * 2**10
"""Bytes a pixel that no network is expected to need, seven times what the published one takes. Where even these are
free there is nothing to estimate, which for a few small photographs takes longer than encoding them."""


class Estimate(NamedTuple):
    """Peak bytes of encoding ``V`` views: ``fixed + slope * V``, beside the weights."""

    fixed: float
    slope: float

    def __call__(self, num_views: int) -> int:
        """Bytes for a number of views."""
        return int(self.fixed + self.slope * num_views)

    def fits(self, available: int) -> int:
        """The most views that a number of bytes allows; 0 if not even one."""
        return max(0, int((available - self.fixed) / self.slope)) if self.slope > 0 else 0


class PeakMemory(TorchDispatchMode):
    """Counts the bytes of live storages that operations make."""

    def __init__(self, weights: Sequence[Tensor]) -> None:
        super().__init__()
        self.live, self.peak = 0, 0
        # Views of weights are nothing new.
        self._known = {weight.untyped_storage()._cdata for weight in weights}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):  # noqa: ANN001, ANN204  (torch calls it)
        result = func(*args, **(kwargs or {}))
        pytree.tree_map_only(Tensor, self._count, result)
        return result

    def _count(self, tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        key, size = storage._cdata, storage.nbytes()
        if key not in self._known:
            self._known.add(key)
            self.live += size
            self.peak = max(self.peak, self.live)
            weakref.finalize(storage, self._forget, key, size)
        return tensor

    def _forget(self, key: int, size: int) -> None:
        self._known.discard(key)
        self.live -= size


def peak(function: Callable[[], object], weights: Sequence[Tensor] = ()) -> int:
    """The most bytes that tensors made by a function hold at one time, weights apart."""
    with torch.no_grad(), PeakMemory(weights) as memory:
        result = function()
    del result
    return memory.peak


def encoding(backbone: Backbone, size: tuple[int, int], dtype: torch.dtype = torch.float32) -> Estimate | None:
    """What encoding views of a size takes.

    Args:
        backbone: Left as it is; its copy without memory is followed.
        size: Height and width of the views.
        dtype: Of the images.

    Returns:
        ``None``, and a line in the log, for a backbone whose computation depends on values, which tensors without
        memory do not have.

    Raises:
        ValueError: The backbone refuses such views.
    """
    # From here on, heads decode chunk by chunk: what one chunk takes no longer grows.
    few, many = 8, 16
    with torch.no_grad(), FakeTensorMode():
        parts = _without_memory(backbone)

        def encode(num_views: int) -> int:
            images = torch.empty(1, num_views, 3, *size, dtype=dtype)

            def run() -> list[object]:
                embedder, aggregator, geometry_head, gaussian_head = parts
                stem: Tokens = embedder(images)
                features = aggregator(stem)
                kept: list[object] = [stem, features]
                # Cameras in closed form ask for values; they take little beside the rest.
                with contextlib.suppress(DataDependentOutputException):
                    kept.append(geometry_head(features, images))
                return [*kept, gaussian_head(features, images)]

            return peak(run, [weight for part in parts for weight in part.parameters()]) + images.nbytes

        try:
            first, second = encode(few), encode(many)
        except RuntimeError as error:
            if not _asks_for_values(error):
                raise
            _log.warning("what encoding takes cannot be said before: the backbone asks for values (%s)", error)
            return None
    slope = (second - first) / (many - few)
    return Estimate(max(0.0, first - few * slope), slope)


def _asks_for_values(error: RuntimeError) -> bool:
    # PyTorch has no class of its own for the way out to NumPy.
    return isinstance(error, _ASKS_FOR_VALUES) or ".numpy()" in str(error)


def available(device: torch.device) -> int | None:
    """Free bytes on a device; ``None`` where the system does not say."""
    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    if device.type != "cpu":
        return None
    return capacity.free()


def check(backbone: Backbone, num_views: int, size: tuple[int, int], device: torch.device) -> None:
    """Refuse more views than memory allows, before anything is computed.

    Raises:
        ValueError: They do not fit; the message says how many do.
    """
    free = available(device)
    if free is None or num_views * size[0] * size[1] * PLENTY <= USABLE * free:
        return
    estimate = encoding(backbone, size)
    if estimate is None or estimate(num_views) <= USABLE * free:
        return
    fits = estimate.fits(int(USABLE * free))
    advice = f"{fits} fit: set views.max_views={fits}" if fits >= 2 else "not even two fit: set a smaller size"
    raise ValueError(
        f"{num_views} views of {size[1]}x{size[0]} need {gib(estimate(num_views))} beside the weights, and "
        f"{gib(free)} are free; {advice} (groups that overlap), views.short_side or views.take"
    )


def sampled_peak(function: Callable[[], object], *, interval: float = 0.002) -> int:
    """The most bytes of its own that this process holds while a function runs, looked at every ``interval`` seconds.

    Pages of files do not count, such as those of weights that are mapped: the system takes them back when it needs
    them (where it tells them apart, as Linux does).
    """
    process, ended, samples = psutil.Process(), threading.Event(), list[int]()

    def sample() -> None:
        while True:
            usage = process.memory_info()
            samples.append(usage.rss - getattr(usage, "shared", 0))
            if ended.wait(interval):
                return

    thread = threading.Thread(target=sample)
    thread.start()
    try:
        function()
    finally:
        ended.set()
        thread.join()
    return max(samples)


def _without_memory(backbone: Backbone) -> list[nn.Module]:
    """Copies of the four networks, of which no weight is read."""
    parts: tuple[nn.Module, ...] = (
        backbone.embedder,
        backbone.aggregator,
        backbone.geometry_head,
        backbone.gaussian_head,
    )
    memo: dict[int, object] = {}
    for part in parts:
        for parameter in part.parameters():
            empty = torch.empty(parameter.shape, dtype=parameter.dtype)
            memo[id(parameter)] = nn.Parameter(empty, requires_grad=False)
        for buffer in part.buffers():
            memo[id(buffer)] = torch.empty(buffer.shape, dtype=buffer.dtype)
    return [copy.deepcopy(part, memo).eval() for part in parts]
