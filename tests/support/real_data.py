"""Where the real photographs and paintings for tests lie, if they lie anywhere."""

import os
from pathlib import Path

import pytest

ROOT = Path(os.environ.get("ANYSTYLE_TEST_DATA", Path(__file__).parents[3] / "shared" / "data"))


def real(path: str) -> Path:
    """A file or folder of the real data; the test is skipped where it is absent."""
    if not (ROOT / path).exists():
        pytest.skip(f"{path} of the real test data is absent; set ANYSTYLE_TEST_DATA to its folder")
    return ROOT / path
