"""How kernels are compiled."""

import logging
from collections.abc import Callable
from typing import Any

from numba import njit

logger = logging.getLogger(__name__)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel on its first call, and keep the machine code on disk where there is a place for it.

    Kernels release the interpreter's lock, divide as C does, and may fuse a product and a sum.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:
        # No cache folder can be written: neither beside an installed package nor in the user's home.
        logger.info("no folder for compiled kernels can be written; they are compiled anew in every process")
        return njit(**options)(function)
