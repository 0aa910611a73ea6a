"""How much memory is left, and a refusal of what would take more, before it is spent."""

import sys
from pathlib import Path

import psutil

from anystyle.errors import UserError

USABLE = 0.9
"""The fraction of free memory that is counted on: allocators and the system need the rest."""


def free() -> int:
    """Bytes that this process may still take: of the machine, of its control groups, of its own limit."""
    left = [psutil.virtual_memory().available, *_left_in_groups(), *_left_of_limit()]
    return max(0, min(left))


def require(needed: int, what: str, advice: str) -> None:
    """Refuse what does not fit.

    Args:
        needed: Bytes.
        what: Takes them.
        advice: What to do instead.

    Raises:
        UserError: They are more than there are; the message says all three, and what is free.
    """
    # Little things are not worth the question, which reads files of the system.
    if needed > 1 << 26 and needed > USABLE * (left := free()):
        raise UserError(f"{what}: this takes {gib(needed)} of memory, and {gib(left)} are free; {advice}")


def gib(count: int | float) -> str:
    """Bytes for people."""
    return f"{count / 2**30:.1f} GiB"


def _left_of_limit() -> list[int]:
    """What ``ulimit -v`` leaves, where it is set."""
    if sys.platform != "linux":
        return []
    process = psutil.Process()
    limit, _ = process.rlimit(psutil.RLIMIT_AS)
    return [] if limit == psutil.RLIM_INFINITY else [limit - process.memory_info().vms]


def _left_in_groups(root: Path = Path("/sys/fs/cgroup"), belongs: Path = Path("/proc/self/cgroup")) -> list[int]:
    """What the limits of this process's control groups leave, of version 2 and 1; those of containers among them."""
    left: list[int] = []
    try:
        lines = [line.split(":", 2) for line in belongs.read_text().splitlines()]
    except OSError:
        return left
    for _, controllers, path in lines:
        if controllers == "":
            names, top = ("memory.max", "memory.current", "file "), root
        elif "memory" in controllers.split(","):
            names, top = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache "), root / "memory"
        else:
            continue
        folder = top / path.lstrip("/")
        # In a container the path may be one of the machine's; what is mounted is the container's own group.
        for group in {folder, *(parent for parent in folder.parents if parent.is_relative_to(top)), top}:
            left += _left_in(group, *names)
    return left


def _left_in(group: Path, limit: str, used: str, cached: str) -> list[int]:
    try:
        most = (group / limit).read_text().strip()
        if most == "max":
            return []
        lines = (group / "memory.stat").read_text().splitlines()
        pages = next((int(line.removeprefix(cached)) for line in lines if line.startswith(cached)), 0)
        return [int(most) - int((group / used).read_text()) + pages]
    except (OSError, ValueError):
        return []
