"""An embedding that is optimised for one scene."""

from dataclasses import replace

import pytest
import torch

import anystyle
from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.methods.colors import colors_alone
from anystyle.registry.build import build
from anystyle.testing.inputs import images
from anystyle.types import Style, Stylization, Views
from anystyle_methods.refine_embedding import RefineEmbedding
from anystyle_methods.sliced_wasserstein import SlicedWasserstein
from tests.support.scenes import cameras, gaussians


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load("tiny")


def test_the_loss_falls_and_the_branch_stays(stylizer):
    with torch.no_grad():
        scene = stylizer.encode(Views(images(2, (112, 112), seed=1)[None]))
    style = Style(images(1, (112, 112), seed=2))
    embedding, loss = stylizer.embed(image=style.image), SlicedWasserstein()
    weights = {name: value.clone() for name, value in stylizer.branch.state_dict().items()}

    def distance(result):
        renders = stylizer.render(result, scene.cameras)
        return float(loss(Stylization(scene.views, style, embedding, scene, result, renders)))

    with torch.no_grad():
        before = distance(stylizer.restyle(scene, embedding))
    method = RefineEmbedding(losses={"palette": loss}, num_steps=8, learning_rate=0.1)
    refined = method(stylizer, scene, style, embedding)
    with torch.no_grad():
        assert distance(refined) < 0.95 * before
    assert all(torch.equal(value, weights[name]) for name, value in stylizer.branch.state_dict().items())
    assert torch.equal(refined.harmonics, method(stylizer, scene, style, embedding).harmonics)


def test_what_it_cannot_do_is_told(stylizer):
    with pytest.raises(UserError, match="method"):
        RefineEmbedding(losses={})
    for wrong in ({"num_steps": 0}, {"learning_rate": 0.0}):
        with pytest.raises(UserError, match=rf"method\.{next(iter(wrong))}"):
            build(Method, {"_target_": f"{RefineEmbedding.__module__}.RefineEmbedding", **wrong})
    loss = {"palette": SlicedWasserstein()}
    fitted, views = gaussians(1, 4), cameras(1, 1, (16, 16))
    scene = replace(colors_alone(Views(images(1, (16, 16), seed=0)[None], views)), gaussians=fitted)
    style = Style(images(1, (16, 16), seed=3))
    with pytest.raises(UserError, match="feedforward"):
        RefineEmbedding(losses=loss)(stylizer, scene, style, stylizer.embed(image=style.image))
