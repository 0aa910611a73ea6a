"""Exchanging photographs changes nothing, neither the reconstruction nor what style makes of it."""

import pytest
import torch

import anystyle
from anystyle.data.folder import read_views
from anystyle.methods.branch import Branch
from anystyle.testing.inputs import images
from anystyle.types import Style, Views
from tests.support.real_data import real

ORDER = [2, 0, 3, 1]
ROUNDING = 5e-5
"""Mean difference of two renders whose sums were taken in another order: an eightieth of a level of 8 bits."""


def photographs(capture):
    """Views of a procedural scene without their cameras, or photographs of a real place."""
    if capture == "procedural":
        scenes = anystyle.catalog().find("scenes", "procedural").load()
        return Views(scenes(split="heldout", size=112).read(11, [0, 1, 2, 3]).images)
    files = sorted(real(capture).glob("*.png"))[:12:3]
    return read_views(files, short_side=112, multiple=14, max_views=4)[0]


@torch.no_grad()
def changes(stylizer, views, order):
    """Mean changes of the unstyled render and of styled ones where photographs are exchanged, in [0, 1]."""
    first, exchanged = stylizer.encode(views), stylizer.encode(views.select(order))
    styles = None, stylizer.embed(image=images(1, (128, 128), seed=5)), stylizer.embed(text="blue and yellow swirls")

    def render(scene, style):
        gaussians = stylizer.unstyled(scene) if style is None else stylizer.restyle(scene, style)
        return stylizer.render(gaussians, scene.cameras).color[0].clamp(0, 1)

    before, after = ([render(scene, style) for style in styles] for scene in (first, exchanged))
    assert all((style - before[0]).abs().mean() > 0.05 for style in before[1:])
    unstyled, *styled = (float((a[order] - b).abs().mean()) for a, b in zip(before, after, strict=True))
    return unstyled, styled


@pytest.mark.parametrize(
    ("backbone", "capture"),
    [
        pytest.param("anysplat_tiny", "procedural", marks=pytest.mark.slow),
        ("anysplat_tiny", "scenes/train/images"),
        pytest.param("depth_anything_tiny", "procedural", marks=pytest.mark.slow),
    ],
)
def test_exchanging_photographs_changes_a_style_by_no_more_than_the_scene(backbone, capture):
    """Which view the others are seen from depends on what they show: nothing changes but the rounding of sums."""
    stylizer = anystyle.load("painter", [f"backbone={backbone}"])
    views = photographs(capture)
    unstyled, styled = changes(stylizer, views, ORDER)
    # The painter amplifies what the scene changes by, up to ten times.
    assert max(styled) <= 10 * unstyled + ROUNDING
    assert unstyled < ROUNDING
    unstyled, styled = changes(stylizer, views.select([0, 1]), [1, 0])
    assert max(unstyled, *styled) < ROUNDING
    stylizer.backbone.embedder.reference = "first"
    unstyled, styled = changes(stylizer, views, ORDER)
    assert min(unstyled, *styled) > 50 * ROUNDING


def exchanged_scenes():
    """A fitted scene, and the same with its photographs exchanged."""
    from tests.support import worlds

    scene = worlds.scene()
    return scene, scene.map(lambda tensor: tensor[:, ORDER] if tensor.shape[:2] == (1, 4) else tensor)


@torch.no_grad()
def test_exchanging_photographs_of_a_fitted_scene_changes_nothing():
    """Its Gaussians stay where they are, and which view paints a place does not depend on the order of views."""
    stylizer, (scene, exchanged) = anystyle.load("painter"), exchanged_scenes()
    assert not torch.equal(scene.views.images, exchanged.views.images)
    embedding = stylizer.embed(image=images(1, (128, 128), seed=5))
    for how in (0, 6):
        method = Branch(fit_colors=how)
        first, other = (
            stylizer.render(method(stylizer, one, Style(), embedding), scene.cameras).color
            for one in (scene, exchanged)
        )
        torch.testing.assert_close(other, first, rtol=0, atol=2e-3)
        assert (first - stylizer.render(scene.gaussians, scene.cameras).color).abs().mean() > 0.05
