"""``model=tiny_paper_taught``: the paper's mechanism, taught by Magenta's pictures first."""

import torch
import torch.nn.functional as F

import anystyle
from anystyle.testing.inputs import images
from anystyle_magenta.teacher import Teacher
from anystyle_tiny.procedural.scenes import ProceduralScenes


@torch.no_grad()
def test_it_is_nearer_to_its_teacher_than_a_model_without_one_and_knows_colours():
    views = ProceduralScenes(split="heldout", size=112, num_scenes=1).read(0, [0, 2])
    style = images(1, (112, 112), seed=4) * torch.tensor([1.0, 0.5, 0.2]).view(3, 1, 1)
    target, distances = Teacher().stylized(views.images, style), []
    for name in ("tiny_paper", "tiny_paper_taught"):
        stylizer = anystyle.load(name)
        scene = stylizer.encode(views)
        styles = (stylizer.embed(image=style), *(stylizer.embed(text=f"shades of {name}") for name in ("red", "blue")))
        painted, *colors = (stylizer.render(stylizer.restyle(scene, each), scene.cameras).color for each in styles)
        distances.append(float(F.l1_loss(painted, target)))
    assert distances[1] < 0.8 * distances[0]
    red, blue = (color[0].mean((0, 2, 3)) for color in colors)
    assert red[0] - red[2] > blue[0] - blue[2] + 0.1
