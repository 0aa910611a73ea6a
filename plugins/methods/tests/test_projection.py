"""Photographs stylized one by one in 2D, and solved back."""

import pytest
import torch
from PIL import Image

from anystyle.io.sheet import to_pil
from anystyle.pipeline.load import load_model
from anystyle.pipeline.request import Request
from anystyle_methods.projection import stylized_views
from tests.support.worlds import method, painting, run, scene, stylizer


def test_each_view_is_stylized_by_itself():
    model, given = stylizer(), scene()
    embedding = model.embed(image=painting().image)
    views = stylized_views(model, given, embedding)
    assert views.shape == (4, 3, 48, 48) and 0 <= views.min() <= views.max() <= 1
    first = stylized_views(model, type(given)(**{**vars(given), "views": given.views.select([2, 1, 0, 3])}), embedding)
    torch.testing.assert_close(first[[2, 1, 0, 3]], views)


def test_colours_that_can_be_had_are_had(tmp_path):
    """A folder of renders in other colours gives those colours, whatever stylized them."""
    model, given = stylizer(), scene()
    target = given.gaussians.harmonics.flip(-1)
    with torch.no_grad():
        changed = type(given.gaussians)(**{**vars(given.gaussians), "harmonics": target})
        renders = model.render(changed, given.cameras).color[0]
    for view, render in enumerate(renders):
        to_pil(render).save(tmp_path / f"{view}.png")
    result = run(method("method=projection", f"method.images={tmp_path}", "method.steps=20"))
    with torch.no_grad():
        shown = model.render(result, given.cameras).color[0]
    assert (shown - renders).abs().mean() < 0.02
    assert torch.equal(result.means, given.gaussians.means)


def test_what_cannot_be_used_is_said(tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match="has 1 images, and the scene has 4 views"):
        run(method("method=projection", f"method.images={tmp_path}"))
    with pytest.raises(ValueError, match=r"method\.steps"):
        method("method=projection", "method.steps=-1")
    assert load_model(Request(overrides=("method=projection",)), stylizer=stylizer()).method.steps == 8
