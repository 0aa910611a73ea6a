"""How much memory is free, and refusing what would take more before it is allocated."""

import re
import sys
from pathlib import Path

import psutil

from anystyle.errors import UserError

USABLE = 0.9
"""The fraction of free memory that is counted on: allocators and the system need the rest."""


def free() -> int:
    """Bytes that this process may still allocate: of the machine, of its container, of its own ``ulimit -v``."""
    left = [psutil.virtual_memory().available, *_left_in_container()]
    if sys.platform == "linux":
        process = psutil.Process()
        limit, _ = process.rlimit(psutil.RLIMIT_AS)
        left += [] if limit == psutil.RLIM_INFINITY else [limit - process.memory_info().vms]
    return max(0, min(left))


def require(needed: int | float, what: str, advice: str, left: int | None = None) -> None:
    """Raise a UserError if ``needed`` bytes are not ``left``, or else :func:`free`: what needs them, and advice."""
    if left is None and needed <= 1 << 26:  # for so little it is not worth reading the system's files
        return
    left = free() if left is None else left
    if needed > USABLE * left:
        raise UserError(f"{what}: this takes {gib(needed)} of memory, and {gib(left)} are free; {advice}")


def gib(count: int | float) -> str:
    """A number of bytes as text, in GiB."""
    return f"{count / 2**30:.1f} GiB"


def _left_in_container(group: Path = Path("/sys/fs/cgroup")) -> list[int]:
    try:
        pages = re.search(r"^file (\d+)$", (group / "memory.stat").read_text(), re.MULTILINE)  # can be reclaimed
        limit, used = (int((group / f"memory.{name}").read_text()) for name in ("max", "current"))
    except (OSError, ValueError):  # no such control group, or its limit is "max"
        return []
    return [limit - used + int(pages[1] if pages else 0)]
