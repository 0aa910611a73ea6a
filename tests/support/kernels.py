"""What a card would be asked for, counted on the CPU."""

from typing import Any

from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

NO_KERNEL = {"empty", "empty_strided", "new_empty", "new_empty_strided", "empty_like", "detach", "_unsafe_view"}
WAITS = {"_local_scalar_dense", "nonzero", "masked_select", "repeat_interleave", "_unique2"}
"""What a card's host waits for, since it reads a value or a size."""


class Kernels(TorchDispatchMode):
    """Counts what is computed, without views and metadata, and what of it a card's host waits for.

    With a ``device``, nothing may be made on another one, nor waited for.
    """

    def __init__(self, device: str | None = None) -> None:
        super().__init__()
        self.device, self.count, self.waits = device, 0, 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result, name = func(*args, **(kwargs or {})), func.overloadpacket.__name__
        self.waits += name in WAITS
        assert self.device is None or not self.waits, f"a card's host waits for {name}"
        for leaf in tree_leaves(result) if self.device else ():
            assert not isinstance(leaf, Tensor) or leaf.device.type == self.device, f"{name} made {leaf.device}"
        is_view = any(each.alias_info and not each.alias_info.is_write for each in func._schema.returns)
        self.count += not is_view and name not in NO_KERNEL
        return result
