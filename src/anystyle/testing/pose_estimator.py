"""What an estimator of cameras promises: see :class:`anystyle.contracts.PoseEstimator`."""

from functools import cache

from PIL import Image

from anystyle.contracts import PosedViews, PoseEstimator, Verdict
from anystyle.io.sheet import to_pil
from anystyle.testing import asserts
from anystyle.testing.reconstruction import photographs
from anystyle.testing.subject import Subject
from anystyle.types import Original

MULTIPLE = 16


def test_gives_cameras_or_a_verdict(plugin: Subject[PoseEstimator]) -> None:
    """Of photographs it gives views with cameras, or the verdict alone, in which case the cameras ``failed``."""
    result = _run(plugin)
    assert isinstance(result, PosedViews | Verdict), f"a {type(result).__name__}"
    verdict = result.verdict if isinstance(result, PosedViews) else result
    given = f"a {type(result).__name__} of trust {verdict.trust!r}"
    assert (verdict.trust == "failed") == isinstance(result, Verdict), given
    assert verdict.trust == "good" or verdict.reasons, f"{given} without a reason"
    assert all(len(reason.splitlines()) == 1 for reason in verdict.reasons), f"reasons of one line: {verdict.reasons}"


def test_views_have_cameras_and_sources(plugin: Subject[PoseEstimator]) -> None:
    """All views have one size, a rigid camera, a source, and the points that they show, in the order of the input."""
    result = _run(plugin)
    if isinstance(result, Verdict):
        return
    views, given = result.views, [source.name for source in result.sources]
    lengths = views.images.shape[1], len(given), len(result.points)
    assert len(set(lengths)) == 1, f"{lengths[0]} views, {lengths[1]} sources and points of {lengths[2]} views"
    assert given == [name for name in photographs().names if name in given], f"sources {given} are not in order"
    assert not any(side % MULTIPLE for side in views.size), f"views of {views.size} with `multiple` of {MULTIPLE}"
    assert views.cameras is not None, "views without cameras"
    asserts.cameras(views.cameras, views.size)
    asserts.srgb(views.images, "the views")
    for points in result.points:
        valid = points.ndim == 2 and points.shape[1] == 3 and bool(points.isfinite().all())
        assert valid, f"points of shape {list(points.shape)} or that are not finite; give [_, 3] in world space"


def test_gives_the_same_twice(plugin: Subject[PoseEstimator]) -> None:
    """A new instance gives the same cameras for the same photographs."""
    first, second = _run(plugin), _run.__wrapped__(plugin)
    assert type(first) is type(second), "cameras one time, and none the other"
    if isinstance(first, PosedViews) and isinstance(second, PosedViews):
        asserts.same(second.views, first.views, "the views of a second run")


@cache
def _run(plugin: Subject[PoseEstimator]) -> PosedViews | Verdict:
    views = photographs()
    named = zip(views.names, views.images[0], strict=True)
    originals = [Original(name, None, views.size, to_pil(picture), Image.Exif()) for name, picture in named]
    return plugin.build()(originals, short_side=48, multiple=MULTIPLE, enlarge=False, on_progress=lambda line: None)
