"""How much freed memory the allocator keeps."""

import ctypes
from contextlib import suppress


def keep_freed(up_to: int) -> None:
    """Give freed memory back to the system, and from now on keep blocks of up to so many bytes, to be used again.

    By glibc; other allocators have rules of their own. glibc's, up to twice the largest block that was freed before,
    leaves gaps between a style's large blocks that those of the next do not fit in.
    """
    with suppress(OSError, AttributeError, TypeError):
        libc = ctypes.CDLL(None)
        libc.malloc_trim(0)
        libc.mallopt(-3, up_to)  # M_MMAP_THRESHOLD
        libc.mallopt(-1, 2 * up_to)  # M_TRIM_THRESHOLD
