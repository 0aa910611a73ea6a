"""``model=tiny_paper_taught``: the paper's mechanism, taught by Magenta's pictures first."""

import pytest
import torch
import torch.nn.functional as F

import anystyle
from anystyle.testing.inputs import images
from anystyle_magenta.teacher import Teacher
from anystyle_tiny.procedural.scenes import ProceduralScenes


@pytest.fixture(scope="module")
def views():
    return ProceduralScenes(split="heldout", size=112, num_scenes=1).read(0, [0, 2])


@torch.no_grad()
def test_it_is_nearer_to_its_teacher_than_a_model_without_one(views):
    style = images(1, (112, 112), seed=4) * torch.tensor([1.0, 0.5, 0.2]).view(3, 1, 1)
    target = Teacher().stylized(views.images, style)
    distances = {}
    for name in ("tiny_paper", "tiny_paper_taught"):
        stylizer = anystyle.load(name)
        scene = stylizer.encode(views)
        render = stylizer.render(stylizer.restyle(scene, stylizer.embed(image=style)), scene.cameras)
        distances[name] = float(F.l1_loss(render.color, target))
    assert distances["tiny_paper_taught"] < 0.8 * distances["tiny_paper"]


@torch.no_grad()
def test_texts_turn_a_scene_to_their_colours(views):
    stylizer = anystyle.load("tiny_paper_taught")
    scene = stylizer.encode(views)
    red, blue = (
        stylizer.render(stylizer.restyle(scene, stylizer.embed(text=text)), scene.cameras).color[0].mean((0, 2, 3))
        for text in ("shades of red", "shades of blue")
    )
    assert red[0] - red[2] > blue[0] - blue[2] + 0.1
