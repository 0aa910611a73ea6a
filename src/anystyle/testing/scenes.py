"""What a source of scenes promises: see :class:`anystyle.contracts.SceneSource`."""

from dataclasses import replace

import torch
from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.geometry.warp import reproject, sample_at
from anystyle.testing import asserts
from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Geometry, Views
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


def test_views_agree(plugin: Subject[SceneSource]) -> None:
    """Where cameras and depth are known, what a view shows is seen in the next one where they say, as far away."""
    views = plugin.instance.read(0, _selected(plugin.instance, 0)[:2])
    if views.cameras is None or views.depth is None or views.images.shape[1] < 2:
        return
    still = (views.images[0, 1] - views.images[0, 0]).abs().mean(0).median()
    color, depth = _disagreement(views, views.depth)
    places = "are poses world_from_camera, in OpenCV axes and the unit of the depth, and intrinsics in pixels?"
    assert depth < 0.05, f"depth differs by {depth:.1%} from that of the next view; {places}"
    worse = f"colours of the next view differ by {color:.3f} as the cameras say, and by {still:.3f} at the same pixel"
    assert color <= max(0.45 * float(still), 0.02), f"{worse}; {places}"
    unit = Geometry(views.cameras, torch.ones_like(views.depth), views.depth).points()
    rays = (unit - views.cameras.world_from_camera[..., None, None, :3, 3]).norm(dim=-1)
    along_z = _disagreement(views, views.depth / rays)[1]
    assert depth < max(0.005, 2 * along_z), "depth agrees better as distance along the ray; give distance along z"
    for half in (0.5, -0.5):  # as in programs that count from the middle of the first pixel; depth must be accurate
        lenses = views.cameras.intrinsics + half * torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
        moved = _disagreement(replace(views, cameras=replace(views.cameras, intrinsics=lenses)), views.depth)[1]
        told = f"depth agrees better with principal points moved by {half} pixels; the first's middle is (0.5, 0.5)"
        assert depth < max(1e-5, 2 * moved), told


def _disagreement(views: Views, depth: Tensor) -> tuple[float, float]:
    """Medians of how far colours, and depths relative to each other, of the first view are from those of the second."""
    cameras = views.cameras
    assert cameras is not None
    lenses, poses = cameras.intrinsics, cameras.world_from_camera
    moved = reproject(depth[:, 0], lenses[:, 0], lenses[:, 1], cameras.camera_from_world[:, 1] @ poses[:, 0])
    seen = sample_at(torch.cat([views.images, depth[:, :, None]], dim=2)[:, 1], moved.displacement)
    known = moved.inside & (seen[:, 3] > 0)
    assert float(known.float().mean()) > 0.05, "hardly anything of a view is seen in the next one, by cameras and depth"
    color = (seen[:, :3] - views.images[:, 0]).abs().mean(1)[known].median()
    return float(color), float((moved.depth / seen[:, 3] - 1).abs()[known].median())


def _selected(source: SceneSource, scene: int) -> list[int]:
    return list(range(min(source.num_views(scene), 3)))
