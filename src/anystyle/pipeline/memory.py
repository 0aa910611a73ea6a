"""The memory that encoding takes, estimated by running the network on fake tensors, which have shapes but no values."""

import contextlib
import copy
import logging
import weakref
from collections.abc import Callable, Iterable

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode  # PyTorch documents it, without a public path
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

from anystyle.contracts import Backbone
from anystyle.types import Cameras

_log = logging.getLogger(__name__)


class _PeakMemory(TorchDispatchMode):
    """Counts the bytes of live storages that operations allocate, except those of ``weights``."""

    def __init__(self, weights: Iterable[Tensor]) -> None:
        super().__init__()
        self.live, self.peak = 0, 0
        self._known = {weight.untyped_storage()._cdata for weight in weights}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):  # noqa: ANN001, ANN204  (torch calls it)
        result = func(*args, **(kwargs or {}))
        pytree.tree_map_only(Tensor, self._count, result)
        return result

    def _count(self, tensor: Tensor) -> None:
        storage = tensor.untyped_storage()
        key, size = storage._cdata, storage.nbytes()
        if key not in self._known:
            self._known.add(key)
            self.live += size
            self.peak = max(self.peak, self.live)
            weakref.finalize(storage, self._forget, key, size)

    def _forget(self, key: int, size: int) -> None:
        self._known.discard(key)
        self.live -= size


def peak(function: Callable[[], object], weights: Iterable[Tensor] = ()) -> int:
    """The largest number of bytes that tensors made by a function hold at one time, except weights."""
    with torch.no_grad(), _PeakMemory(weights) as memory:
        result = function()
    del result
    return memory.peak


def encoding(backbone: Backbone, size: tuple[int, int]) -> tuple[float, float] | None:
    """Peak bytes of encoding views beside the weights: a constant, and bytes per view.

    ``None``, with a warning in the log, where the network cannot run on tensors without values.
    """
    parts = nn.ModuleList([backbone.embedder, backbone.aggregator, backbone.geometry_head, backbone.gaussian_head])
    with torch.no_grad(), FakeTensorMode(allow_non_fake_inputs=True):
        memo: dict[int, object] = {id(item): torch.empty(item.shape, dtype=item.dtype) for item in parts.buffers()}
        for weight in parts.parameters():
            memo[id(weight)] = nn.Parameter(torch.empty(weight.shape, dtype=weight.dtype), requires_grad=False)
        parts = copy.deepcopy(parts, memo).eval()
        embedder, aggregator, geometry_head, gaussian_head = parts

        def encode(num_views: int) -> int:
            images = torch.empty(1, num_views, 3, *size)
            pose, lens = (torch.eye(side).expand(1, num_views, side, side) for side in (4, 3))
            cameras = Cameras(pose, lens, size)

            def run() -> list[object]:
                stem = embedder(images, *([cameras] if embedder.reads_cameras else []))
                features = aggregator(stem)
                kept: list[object] = [stem, features]
                # Cameras in closed form depend on values; they take little memory.
                with contextlib.suppress(RuntimeError):
                    kept.append(geometry_head(features, images, *([cameras] if geometry_head.reads_cameras else [])))
                return [*kept, gaussian_head(features, images)]

            return peak(run, parts.parameters()) + images.nbytes

        try:
            # From 8 views on heads decode in chunks, whose memory no longer grows.
            first, second = encode(8), encode(16)
        except Exception as error:  # it depends on values, or is broken, which running it will show
            _log.warning("memory is not estimated: the backbone cannot run on tensors without values (%s)", error)
            return None
    slope = (second - first) / 8
    return max(0.0, first - 8 * slope), slope
