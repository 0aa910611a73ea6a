"""How numeric kernels are compiled."""

import logging
from collections.abc import Callable
from typing import Any

from numba import njit

logger = logging.getLogger(__name__)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a kernel on its first call, without the interpreter's lock and with C's division.

    The machine code is kept on disk, unless no folder for it can be written.
    """
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:
        logger.info("compiled kernels cannot be kept on disk here: every process compiles them anew")
        return njit(nogil=True, error_model="numpy")(function)
