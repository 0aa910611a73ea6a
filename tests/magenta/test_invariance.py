"""What exchanging photographs changes: the reconstruction, and hardly what style makes of it."""

from dataclasses import replace

import pytest
import torch

import anystyle
from anystyle.testing.inputs import images
from methods import worlds

ORDER = [2, 0, 3, 1]
TEXTS = ("blue and yellow swirls", "black and white ink drawing")


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load("painter")


@torch.no_grad()
def test_exchanging_photographs_changes_a_style_by_no_more_than_the_scene(stylizer):
    """Renders change with the geometry that they are painted on. What the style adds to that, the geometry held still,
    is less than the change of the unstyled scene, and so the renders change as any picture on that geometry does."""
    scenes = anystyle.catalog().find("scenes", "procedural").load()
    views = scenes(split="heldout", size=112).read(11, [0, 1, 2, 3])
    first, exchanged = stylizer.encode(views), stylizer.encode(views.select(ORDER))

    def render(scene, color):
        attributes = replace(scene.attributes, color=color)
        gaussians = stylizer.backbone.adapter(attributes, scene.geometry, scene.clusters)
        return stylizer.render(gaussians, scene.cameras).color[0].clamp(0, 1)

    def change(one, other):
        return float((one - other).abs().mean())

    unstyled = change(render(first, first.attributes.color)[ORDER], render(exchanged, exchanged.attributes.color))
    assert unstyled > 1e-3
    pictures = stylizer.embed(image=images(2, (128, 128), seed=5))
    texts = stylizer.embed(text=TEXTS)
    for vector in torch.cat([pictures.vector, texts.vector])[:, None]:
        embedding = replace(pictures, vector=vector, direction=vector)
        color, other = stylizer.branch(first, embedding).color, stylizer.branch(exchanged, embedding).color
        result, fixed = render(exchanged, other), render(exchanged, color[:, ORDER])
        before = render(first, color)[ORDER]
        assert change(result, fixed) < 0.7 * unstyled
        assert change(result, before) < 1.05 * change(fixed, before)


@torch.no_grad()
def test_exchanging_photographs_of_a_fitted_scene_changes_nothing(stylizer):
    """Its Gaussians stay where they are, and which view paints a place does not depend on the order of views."""
    scene = worlds.scene()
    exchanged = scene.map(lambda tensor: tensor[:, ORDER] if tensor.shape[:2] == (1, 4) else tensor)
    assert not torch.equal(scene.views.images, exchanged.views.images)
    embedding = stylizer.embed(image=images(1, (128, 128), seed=5))
    for how in ("mean", 6):
        stylizer.fit_colors = how
        first, other = (
            stylizer.render(stylizer.restyle(one, embedding), scene.cameras).color for one in (scene, exchanged)
        )
        torch.testing.assert_close(other, first, rtol=0, atol=2e-3)
        assert (first - stylizer.render(scene.gaussians, scene.cameras).color).abs().mean() > 0.05
