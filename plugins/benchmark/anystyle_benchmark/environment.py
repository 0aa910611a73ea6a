"""Environments of pinned packages, one per set of requirements, made when a method first needs it."""

import hashlib
import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

from filelock import FileLock

from anystyle.errors import UserError


def interpreter(requirements: Sequence[str]) -> Path:
    """The Python of an environment with these packages and nothing else; the running one if there are none."""
    if not requirements:
        return Path(sys.executable)
    wanted = "\n".join(sorted(requirements))
    folder = environments() / hashlib.sha256(f"{sys.version_info[:2]}\n{wanted}".encode()).hexdigest()[:16]
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock"):
        if not (folder / ".ready").is_file():
            venv.create(folder, clear=True, with_pip=True)
            install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements]
            done = subprocess.run(install, capture_output=True, text=True, check=False)
            if done.returncode:
                raise UserError(f"its environment cannot be installed: {last_line(done.stderr)}")
            (folder / ".ready").write_text(wanted)
    return python


def environments() -> Path:
    """The folder of all environments; ``ANYSTYLE_ENVIRONMENTS`` names another."""
    return Path(os.environ.get("ANYSTYLE_ENVIRONMENTS") or Path.home() / ".cache" / "anystyle" / "environments")


def last_line(text: str) -> str:
    """The last line that says something; what a program ends with when it fails."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "it printed nothing")
