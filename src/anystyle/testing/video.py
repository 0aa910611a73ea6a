"""What a film promises: see :class:`anystyle.contracts.Video`."""

import tempfile
from pathlib import Path

from anystyle.contracts import Video
from anystyle.io.video import opened
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.inputs import cameras, gaussians
from anystyle.testing.subject import Subject


def test_writes_a_film(plugin: Subject[Video]) -> None:
    """It writes ``video.mp4`` with at least one frame."""
    scene, seen = gaussians(1, 9), cameras(1, 3, (24, 32))
    with tempfile.TemporaryDirectory() as folder:
        plugin.instance.write(scene, seen, lambda path: iter(TorchRenderer()(scene, path).color[0]), Path(folder))
        with opened(Path(folder, "video.mp4")) as container:
            assert next(container.decode(video=0), None) is not None, "a film without frames"
