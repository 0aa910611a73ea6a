"""What a file format promises: see :class:`anystyle.contracts.Format`."""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.testing.inputs import cameras, gaussians
from anystyle.testing.subject import Subject
from anystyle.types import StyledScene


def test_writes_one_file(plugin: Subject[Format]) -> None:
    """It writes the file that is named, the same bytes twice, and leaves nothing else behind, not after an error."""
    assert plugin.cls.up in ("opencv", "y", "z"), f"up={plugin.cls.up!r} is not one of opencv, y, z"
    with tempfile.TemporaryDirectory() as folder:
        first, second, taken = (Path(folder, f"{name}.scene") for name in ("first", "second", "taken"))
        plugin.instance.write(_scene(), first)
        plugin.instance.write(_scene(), second)
        taken.mkdir()
        with pytest.raises((OSError, UserError)):
            plugin.instance.write(_scene(), taken)
        left = {path for path in Path(folder).rglob("*") if path not in (first, second, taken)}
        assert not left, f"{left} beside the file; use `anystyle.io.atomic.atomic_path`"
        assert first.read_bytes() == second.read_bytes(), "other bytes the second time; leave out dates"


def _scene() -> StyledScene:
    scene = gaussians(1, 50, 1)
    pale = replace(scene, harmonics=0.5 * scene.harmonics)
    return StyledScene((("unstyled", pale), ("red", scene)), cameras(1, 2, (24, 32)), ("left", "right"), title="a test")
