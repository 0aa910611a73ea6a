"""What a file format promises: see :class:`anystyle.contracts.Format`."""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.pipeline.export import in_axes
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.inputs import cameras, gaussians
from anystyle.testing.subject import Subject
from anystyle.types import Gaussians, StyledScene
from anystyle.types.scene import AXES


def test_writes_one_file(plugin: Subject[Format]) -> None:
    """It writes the file that is named, the same bytes twice, and leaves nothing else, not after an error."""
    assert plugin.cls.up in AXES, f"up={plugin.cls.up!r} is not one of {', '.join(AXES)}"
    with tempfile.TemporaryDirectory() as folder:
        first, second, taken = (Path(folder, f"{name}.scene") for name in ("first", "second", "taken"))
        plugin.instance.write(_scene(), first)
        plugin.instance.write(_scene(), second)
        taken.mkdir()
        with pytest.raises((OSError, UserError)):
            plugin.instance.write(_scene(), taken)
        left = set(Path(folder).iterdir()) - {first, second, taken}
        assert not left, f"{left} beside the file; use `anystyle.io.atomic.atomic_path`"
        assert first.read_bytes() == second.read_bytes(), "other bytes the second time; leave out dates"


def test_reads_what_it_writes(plugin: Subject[Format]) -> None:
    """What is read shows the pictures that were written, to 30 dB, in the axes that the file says or its format has."""
    cls = plugin.cls
    scene = _scene(moved=not cls.shared)
    kept = scene.styles if cls.many_styles else scene.styles[-1:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "file.scene")
        for up in AXES if cls.reads else ():
            plugin.instance.write(in_axes(up, scene), path)
            read = plugin.instance.read(path)
            assert read.up in (up, cls.up), f"a file in axes {up!r} is read as {read.up!r}"
            assert len(read.styles) == len(kept), f"{len(read.styles)} of {len(kept)} styles are read"
            stated, told = (in_axes("opencv", each).styles for each in (read, replace(read, up=up)))
            for (title, found), (_, other), (name, written) in zip(stated, told, kept, strict=True):
                assert title == name or not cls.many_styles, f"{name!r} is read as {title!r}"
                loss = min(float((_picture(each) - _picture(written)).square().mean()) for each in (found, other))
                assert loss < 1e-3, f"up={up!r}: {name!r} is off by a squared error of {loss:.2g}"
        path.write_bytes(b"damaged")
        with pytest.raises(UserError):
            plugin.instance.read(path)


def _picture(scene: Gaussians) -> Tensor:
    with torch.no_grad():
        return TorchRenderer()(scene, cameras(1, 1, (24, 32))).color


def _scene(*, moved: bool = False) -> StyledScene:
    """A scene in two styles: the first has other colours and, where ``moved``, fewer Gaussians in other places."""
    scene = gaussians(1, 50, 1)
    pale = replace(scene, harmonics=0.5 * scene.harmonics)
    if moved:
        pale = replace(pale, means=pale.means + 0.1).map(lambda tensor: tensor[:, :40])
    return StyledScene((("unstyled", pale), ("red", scene)), cameras(1, 2, (24, 32)), ("left", "right"), title="a test")
