"""``model=painter``: what a scene looks like with no training here, on any backbone."""

import logging

import pytest
import torch

import anystyle
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.pipeline.load import assemble
from anystyle.registry.compose import compose
from anystyle.testing.inputs import images, views
from anystyle_magenta import stylize_images


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load("painter")


@pytest.fixture(scope="module")
def scene(stylizer):
    # The network alone; texturing and widths of strokes have tests of their own.
    stylizer.branch.single_view = stylizer.branch.injectors["color"].own_strokes = False
    return stylizer.encode(views(1, 2, (56, 56)))


@torch.no_grad()
def test_colors_are_the_stylized_ones_and_nothing_else_changes(stylizer, scene):
    embedding = stylizer.embed(image=images(1, (64, 64), seed=9))
    styled = stylizer.branch(scene, embedding)
    for name in ("opacity", "scale", "rotation"):
        assert getattr(styled, name) is getattr(scene.attributes, name)
    pixels = rgb_from_constant(scene.attributes.color[..., 0]).movedim(-1, 2).clamp(0, 1)
    network = stylizer.branch.injectors["color"].network
    expected = stylize_images(network, pixels, embedding.vector, working_size=224, joint=True)
    torch.testing.assert_close(rgb_from_constant(styled.color[..., 0]).movedim(-1, 2), expected, rtol=0, atol=1e-5)


def test_no_warning_is_due_and_the_report_names_the_files(caplog):
    with caplog.at_level(logging.WARNING):
        _, loaded = assemble(compose("stylize", ["model=painter"]))
    assert caplog.records == []
    files = {part: loaded[part]["file"] for part in ("style_encoder", "branch")}
    assert files == {"style_encoder": "arbitrary_predict.onnx", "branch": "arbitrary_transform.onnx"}
    assert all(len(loaded[part]["sha256"]) == 64 for part in files)


@pytest.mark.parametrize("command", ["stylize", "evaluate"])
def test_it_is_the_default_on_a_strangers_backbone_too(command):
    for words in ([], ["backbone=depth_anything_tiny"], ["backbone=anysplat", "weights.backbone=null"]):
        config = compose(command, words)
        assert config.injector._target_.endswith("MagentaInjector") and config.injector.gate == 1
        assert config.style_encoder._target_.endswith("MagentaEncoder")
        assert config.weights.style_encoder is None and config.weights.branch is None
