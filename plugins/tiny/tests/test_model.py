"""``model=tiny``: the paper's mechanism with the weights that come along, taught by Magenta's pictures first."""

import logging

import pytest
import torch
import torch.nn.functional as F

import anystyle
from anystyle.pipeline.load import assemble
from anystyle.registry.compose import compose
from anystyle.testing.inputs import images
from anystyle_magenta.teacher import Teacher
from anystyle_tiny.procedural.scenes import ProceduralScenes


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load("tiny")


@pytest.fixture(scope="module")
def scene(stylizer):
    return stylizer.encode(ProceduralScenes(split="heldout", size=112, num_scenes=1).read(0, [0, 2]))


def test_it_is_the_papers_mechanism_and_trained(stylizer, caplog):
    assert {type(injector).__name__ for injector in stylizer.branch.injectors.values()} == {"ZeroConv"}
    assert list(stylizer.branch.injectors) == [site.name for site in stylizer.backbone.gaussian_head.sites]
    assert stylizer.branch.aggregator is None
    copied = zip(stylizer.branch.gaussian_head.parameters(), stylizer.backbone.gaussian_head.parameters(), strict=True)
    assert all(not copy.equal(original) for copy, original in copied if original.numel() > 100)
    with caplog.at_level(logging.WARNING):
        assemble(compose("stylize", ["model=tiny"]))
    assert caplog.records == []


@torch.no_grad()
def test_texts_and_pictures_turn_a_scene_to_their_colours(stylizer, scene):
    """More red than blue by the one, less by the other, against the scene in no style; the geometry stays."""
    unstyled = stylizer.unstyled(scene)

    def redness(gaussians):
        red, _, blue = stylizer.render(gaussians, scene.cameras).color[0].mean((0, 2, 3))
        return float(red - blue)

    before = redness(unstyled)
    sheet = images(1, (112, 112), seed=4).mean(1, keepdim=True)
    tinted = [sheet * torch.tensor(color).view(3, 1, 1) for color in ((1.0, 0.2, 0.1), (0.1, 0.2, 1.0))]
    for sign, text, image in zip((1, -1), ("shades of red", "shades of blue"), tinted, strict=True):
        for embedding in (stylizer.embed(text=text), stylizer.embed(image=image)):
            styled = stylizer.restyle(scene, embedding)
            assert all(
                getattr(styled, name).equal(getattr(unstyled, name)) for name in ("means", "scales", "opacities")
            )
            assert sign * (redness(styled) - before) > 0.05


@torch.no_grad()
def test_a_scene_in_a_style_is_nearer_to_what_the_teacher_paints_than_the_plain_scene(stylizer, scene):
    style = images(1, (112, 112), seed=4) * torch.tensor([1.0, 0.5, 0.2]).view(3, 1, 1)
    target = Teacher().stylized(scene.views.images, style)
    styled, plain = stylizer.restyle(scene, stylizer.embed(image=style)), stylizer.unstyled(scene)
    near, far = (float(F.l1_loss(stylizer.render(each, scene.cameras).color, target)) for each in (styled, plain))
    assert near < 0.5 * far
