"""How numeric kernels are compiled."""

import inspect
import logging
from collections.abc import Callable, Collection
from typing import Any

from numba import njit

logger = logging.getLogger(__name__)

CONTRACT = frozenset({"contract", "nsz"})
"""LLVM's fast-math flags that fuse a product and a sum and ignore the sign of zero: no sum changes its order."""


def compiled(function: Callable[..., Any], *, fastmath: Collection[str] = ()) -> Callable[..., Any]:
    """Compile a kernel on its first call, without the interpreter's lock and with C's division.

    The machine code is kept on disk if a folder for it can be written; ``fastmath`` are flags of LLVM. Kernels that it
    calls are inlined: the process that compiles would run copies of them that round otherwise than those on disk.
    """
    function = inspect.unwrap(function)  # tests check annotations by wrappers, which numba cannot compile
    options: dict[str, Any] = {"nogil": True, "forceinline": True, "error_model": "numpy", "fastmath": set(fastmath)}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:
        logger.info("compiled kernels cannot be kept on disk here: every process compiles them anew")
        return njit(**options)(function)
