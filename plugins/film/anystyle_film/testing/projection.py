"""What a projection promises: see :class:`anystyle_film.contract.Projection`."""

import torch

from anystyle.testing import asserts
from anystyle.testing.inputs import cameras, gaussians
from anystyle.testing.subject import Subject
from anystyle_film.contract import Projection
from anystyle_film.scene import FilmedScene


def test_sizes_are_even(plugin: Subject[Projection]) -> None:
    """A frame has the height that is asked for, or grows with the scale; both sides are even, as films demand."""
    seen = cameras(1, 3, (48, 64))
    heights = [plugin.instance.size(seen, scale, None)[0] for scale in (0.5, 1.0, 2.0)]
    assert heights == sorted(set(heights)), f"heights of {heights} at scales 0.5, 1 and 2"
    for height in (36, 100):
        size = plugin.instance.size(seen, 1.0, height)
        assert size[0] == height and not any(side % 2 for side in size), f"{size} for a height of {height}"


def test_frames_are_made_of_views(plugin: Subject[Projection]) -> None:
    """Of images of all views it makes a frame of the size; grey images make a grey frame, without seams."""
    seen = cameras(1, 3, (48, 64))
    size = plugin.instance.size(seen, 1.0, 40)
    views = plugin.instance.views(FilmedScene(gaussians(1, 50), seen), seen.select([1]), size)
    asserts.cameras(views, views.size)
    images = torch.full((views.intrinsics.shape[1], 3, *views.size), 0.5)
    frame = plugin.instance.frame(images, size)
    assert frame.shape == (3, *size), f"a frame of shape {list(frame.shape)} for a size of {size}"
    asserts.close(frame, torch.full_like(frame, 0.5), "a frame of grey images")
