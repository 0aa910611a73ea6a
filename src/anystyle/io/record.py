"""Who made a result: the versions, the commit and the machine."""

import os
import platform
import subprocess
from importlib.metadata import version

import torch

from anystyle.paths import SHARED


def commit() -> str:
    """The commit of the checkout, with ``+`` where files differ from it; empty where there is no checkout."""
    if not (SHARED / ".git").exists():
        return ""
    git = ["git", "-C", os.fspath(SHARED), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def versions() -> dict[str, str]:
    """The versions of the packages that numbers depend on most."""
    return {name: version(name) for name in ("anystyle", "torch", "numpy")}


def machine() -> str:
    """The processor's architecture, the system, and the device to compute on."""
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else ""
    return f"{platform.machine()} {platform.system()}, {gpu or f'CPU with {torch.get_num_threads()} thread(s)'}"
