"""What a source of scenes promises: see :class:`anystyle.contracts.SceneSource`."""

from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.testing import asserts
from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Views
from anystyle.types.shapes import check_value


def test_views_are_images(plugin: Subject[SceneSource]) -> None:
    """It has scenes of distinct names; views are one batch of sRGB in [0, 1], with cameras and depth where known."""
    source = plugin.instance
    assert len(source) >= 1, "no scene; override `example`"
    for scene in range(min(len(source), 3)):
        selected, what = _selected(source, scene), f"scene {scene}"
        assert selected, f"{what} has no views; leave it out"
        views = source.read(scene, selected)
        check_value(views, Views, what, B=1, V=len(selected))
        asserts.srgb(views.images, what)
        assert len(views.names) in (0, len(selected)), f"{what}: {len(views.names)} names of {len(selected)} views"
        if views.cameras is not None:
            check_value(views.cameras, Cameras, what, B=1, V=len(selected))
            asserts.cameras(views.cameras, views.size)
        if views.depth is not None:
            assert bool((views.depth >= 0).all()), f"{what}: a depth that is negative or NaN; mark unknown ones by 0"
    names = [plugin.instance.name(scene) for scene in range(min(len(plugin.instance), 50))]
    assert all(names) and len(set(names)) == len(names), f"names {names[:5]}"


def test_any_view_can_be_read(plugin: Subject[SceneSource]) -> None:
    """Each view is the same read alone or with others, in any order; all views of a scene have one size."""
    selected = _selected(plugin.instance, 0)
    together = plugin.instance.read(0, selected)
    for what, order in (("alone", [len(selected) - 1]), ("in another order", list(range(len(selected)))[::-1])):
        views = plugin.instance.read(0, [selected[index] for index in order])
        asserts.same(views, together.select(order), f"views read {what}")
        assert views.names == together.select(order).names, f"names {views.names} of views read {what}"


def test_reading_twice_is_the_same(plugin: Subject[SceneSource]) -> None:
    """A scene is the same bits whatever was read before, in this process or in a worker's copy."""
    selected = _selected(plugin.instance, 0)
    first = plugin.instance.read(0, selected).map(Tensor.clone)
    plugin.instance.read(len(plugin.instance) - 1, [0])
    for what, source in asserts.copies(plugin):
        asserts.same(source.read(0, selected), first, f"scene 0 read again from {what}")


def _selected(source: SceneSource, scene: int) -> list[int]:
    return list(range(min(source.num_views(scene), 3)))
