"""What a source of scenes promises: see :class:`anystyle.contracts.SceneSource`."""

from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.testing.backbone_values import expect_cameras
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import MOST, conform, copies, expect_any, expect_finite, expect_same, expect_srgb
from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Views

Plugin = Subject[SceneSource]


def scenes_are_counted_and_named(plugin: Plugin) -> None:
    """It has at least one scene, of at least one view, and no two scenes of one name."""
    source = plugin.instance
    expect_any(source, "scene")
    names = [source.name(scene) for scene in range(min(len(source), 50))]
    counts = [source.num_views(scene) for scene in range(min(len(source), MOST))]
    expect(
        all(isinstance(name, str) and name for name in names) and len(set(names)) == len(names),
        given=f"names {names[:5]}",
        change="name scenes after their folder or number",
    )
    expect(
        all(isinstance(count, int) and count >= 1 for count in counts),
        given=f"scenes of {counts} views",
        change="leave out scenes without views",
    )


def views_are_images_with_what_is_known(plugin: Plugin) -> None:
    """Views are a batch of one scene on the CPU: sRGB in [0, 1], names, and cameras and depth where known."""
    source = plugin.instance
    for scene in range(min(len(source), MOST)):
        chosen = _chosen(source, scene)
        with attempt(f"reading views {chosen} of scene {scene}", change="see the line named above"):
            views = source.read(scene, chosen)
        _expect_views(views, len(chosen), f"scene {scene}")


def any_view_can_be_read(plugin: Plugin) -> None:
    """Each view is the same read alone or with others, in any order; all views of a scene have one size."""
    source = plugin.instance
    chosen = _chosen(source, 0)
    together = source.read(0, chosen)
    for what, order in (("alone", [len(chosen) - 1]), ("in another order", list(range(len(chosen)))[::-1])):
        reordered = source.read(0, [chosen[index] for index in order])
        expect_same(
            reordered,
            together.select(order),
            what=f"views read {what}",
            change="let nothing depend on which views are read together, neither size, crop nor scale",
        )
        names = together.select(order).names
        expect(
            reordered.names == names,
            given=f"names {reordered.names}",
            expected=f"{names}",
            change="name views by their place in the scene, not in the list asked for",
        )


def reading_twice_is_the_same(plugin: Plugin) -> None:
    """A scene is the same bits whatever was read before, in this process or in a worker's copy."""
    source = plugin.instance
    first = source.read(0, _chosen(source, 0)).map(Tensor.clone)
    last = len(source) - 1
    source.read(last, [0])
    for what, again in copies(plugin):
        expect_same(
            again.read(0, _chosen(source, 0)),
            first,
            what=f"scene 0 read again from {what}",
            change="seed a generator with the scene's number, and cache nothing that is changed later",
        )


def _chosen(source: SceneSource, scene: int) -> list[int]:
    return list(range(min(source.num_views(scene), 3)))


def _expect_views(views: Views, number: int, where: str) -> None:
    conform(views, Views, where, B=1, V=number)
    expect_finite(views, where)
    expect_srgb(views.images, where)
    expect(
        len(views.names) in (0, number),
        given=f"{where}: {len(views.names)} names of {number} views",
        expected="one a view, or none",
        change="name the views that were read",
    )
    if views.cameras is not None:
        conform(views.cameras, Cameras, where, B=1, V=number)
        expect_cameras(views.cameras, views.size)
    if views.depth is not None:
        lowest = float(views.depth.min())
        expect(
            lowest >= 0,
            given=f"{where}: a depth of {lowest:.3g}",
            expected="distances along z, 0 where there is none",
            change="mark pixels without depth by 0",
        )


CHECKS: tuple[Check, ...] = (
    Check(scenes_are_counted_and_named, needed=True),
    Check(views_are_images_with_what_is_known, needed=True),
    Check(any_view_can_be_read),
    Check(reading_twice_is_the_same),
)
