"""What a method promises: see :class:`anystyle.contracts.Method`."""

from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import torch

from anystyle.branch import COLOR
from anystyle.contracts import Method
from anystyle.stylizer import Stylizer
from anystyle.testing import asserts
from anystyle.testing.inputs import images, views
from anystyle.testing.subject import Subject
from anystyle.testing.toy.loss import ToyLoss
from anystyle.testing.toy.stylizer import ToyStylizer
from anystyle.types import Gaussians, Scene, Style
from anystyle.types.progress import Progress
from anystyle.types.seeds import seeded
from anystyle.types.shapes import check_value


def test_gives_gaussians(plugin: Subject[Method]) -> None:
    """It gives finite Gaussians of one scene, without gradients, which can be rendered."""
    gaussians, (stylizer, scene) = _once(plugin), _world()
    check_value(gaussians, Gaussians, "the method", B=1)
    single = all(tensor.dtype == torch.float32 for tensor in vars(gaussians).values())
    assert gaussians.means.shape[1] > 0 and single, "there are no Gaussians, or they are not in single precision"
    asserts.finite(gaussians, "the stylized Gaussians")
    assert not any(tensor.requires_grad for tensor in vars(gaussians).values()), "return `gaussians.detach()`"
    asserts.finite(stylizer.render(gaussians, scene.cameras), "renders of the stylized Gaussians")


def test_leaves_the_scene_alone(plugin: Subject[Method]) -> None:
    """The scene, of pixels or of Gaussians, and the stylizer's weights are left as they were, for other styles."""
    stylizer, scene = _world()
    weights = {name: value.clone() for name, value in stylizer.state_dict().items()}
    for given in (scene, replace(scene, gaussians=stylizer.unstyled(scene))):
        before = given.map(torch.clone)
        _run(plugin, stylizer, given)
        asserts.same(given, before, "the scene")
    asserts.same(stylizer.state_dict(), weights, "weights of the stylizer")


def test_gives_the_same_twice(plugin: Subject[Method]) -> None:
    """A new instance gives the same for the same scene and style, also where the caller turned gradients off."""
    with torch.no_grad():
        asserts.same(_run(plugin, *_world()), _once(plugin), "the Gaussians of a second run")


def test_styles_may_lack_a_part(plugin: Subject[Method]) -> None:
    """A style that is a text alone, or an embedding alone, gives Gaussians or a ValueError."""
    for style in (Style(text=("deep blue",)), Style()):
        with suppress(ValueError):
            _run(plugin, *_world(), style)


def test_progress_can_be_shown(plugin: Subject[Method]) -> None:
    """Every report of progress is one line, and has an image [3, height, width] in [0, 1] or none."""
    reports: list[Progress] = []
    _run(plugin, *_world(), on_progress=reports.append)
    for report in reports:
        assert len(report.line.splitlines()) == 1, f"the report {report.line!r} is not one line"
        if report.thumbnail is not None:
            asserts.srgb(report.thumbnail, "a thumbnail")
            assert report.thumbnail.ndim == 3, f"a thumbnail of shape {list(report.thumbnail.shape)}"


def _world() -> tuple[Stylizer, Scene]:
    with seeded(0):
        stylizer = ToyStylizer(only=COLOR).requires_grad_(False).eval()  # every method can work with pixels' colours
        return stylizer, stylizer.encode(views(1, 2, (16, 24)))


def _run(
    plugin: Subject[Method], stylizer: Stylizer, scene: Scene, style: Style | None = None, **rest: Any
) -> Gaussians:
    given = style or Style(image=images(1, (48, 40), seed=50))
    embedding = stylizer.embed(text="deep blue") if given.image is None else stylizer.embed(image=given.image)
    return plugin.build(losses={"toy": ToyLoss()})(stylizer, scene, given, embedding, **rest)


@cache
def _once(plugin: Subject[Method]) -> Gaussians:
    return _run(plugin, *_world())
