"""Losses of per-scene methods against transcriptions of their equations."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from anystyle.losses.depth_consistency import DepthConsistency
from anystyle.testing.inputs import stylization
from anystyle.testing.oracle import smooth_image
from anystyle.vision import networks, weights
from anystyle_methods.attribute_change import AttributeChange
from anystyle_methods.nnfm import NNFM
from anystyle_methods.scene_loop import color_map
from anystyle_methods.simultaneous_scales import SimultaneousScales
from tests.support.style_cases import filled_vgg_file
from tests.support.style_cases import stylization as images_stylization

RENDERED, PHOTOGRAPHS = smooth_image(11, [1, 2, 3, 64, 80]), smooth_image(12, [1, 2, 3, 64, 80])
STYLE = smooth_image(13, [1, 3, 72, 64])
LAYERS = ("relu1_1", "relu2_1")


@pytest.fixture(autouse=True)
def vgg_of_the_goldens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses find the goldens' VGG in place of the published one; the bundled networks stay in reach."""
    monkeypatch.setenv(weights.FOLDERS, str(filled_vgg_file().parent))


def test_simultaneous_scales_is_its_equation() -> None:
    loss = SimultaneousScales(network="texture", layers=LAYERS, scales=2)
    network, expected = networks.load("texture"), 0.0
    for scale in range(2):
        size = 2**scale
        style = F.avg_pool2d(STYLE, size).double()
        for view in range(2):
            image = F.avg_pool2d(RENDERED[0, view, None], size).double()
            pairs = zip(network.double()(image, LAYERS), network.double()(style, LAYERS), strict=True)
            for features, target in pairs:
                unit = target.mean()
                f, s = (features[0].flatten(1) / unit), (target[0].flatten(1) / unit)
                channels = f.shape[0]
                grams = [x @ x.T / x.shape[1] for x in (f, s)]
                expected += 1e3 / channels**2 * float((grams[0] - grams[1]).square().mean()) / 2
                expected += 1e4 * float((f.mean(1) - s.mean(1)).square().mean()) / 2
                expected += 1e4 * float((f.std(1) - s.std(1)).square().mean()) / 2
    assert float(loss(images_stylization(RENDERED, PHOTOGRAPHS, STYLE))) == pytest.approx(expected, rel=1e-3)


def test_simultaneous_scales_stops_where_pictures_are_too_small() -> None:
    result = images_stylization(RENDERED, PHOTOGRAPHS, STYLE)
    two, many = (SimultaneousScales(network="texture", layers=LAYERS, scales=scales)(result) for scales in (3, 9))
    assert torch.equal(two, many)
    assert float(SimultaneousScales(network="texture", layers=LAYERS)(images_stylization(RENDERED, PHOTOGRAPHS))) == 0


def test_attribute_change_is_a_weighted_l1() -> None:
    result = stylization()
    scale = 0.1 * result.gaussians.scales.mean()  # the sample's own Gaussians have 0.9 of everything
    opacity = 0.1 * result.gaussians.opacities.mean()
    value = AttributeChange(scale_weight=0.3, opacity_weight=0.7)(result)
    torch.testing.assert_close(value, 0.3 * scale + 0.7 * opacity)
    assert AttributeChange()(replace(result, scene=replace(result.scene, gaussians=None))) == 0


def test_depth_of_the_unstyled_scene_is_kept() -> None:
    result = stylization()
    loss = DepthConsistency(reference="render")
    assert loss.needs_unstyled and not DepthConsistency().needs_unstyled
    moved = replace(result.renders, depth=result.renders.depth + 0.5).detach()
    torch.testing.assert_close(loss(replace(result, unstyled=moved)), torch.tensor(0.25))
    with pytest.raises(ValueError, match="there are none"):
        loss(result)


def test_the_first_network_that_is_there_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    assert NNFM(network="vgg19,texture").source.stand_in is None
    monkeypatch.delenv(weights.FOLDERS)
    loss = NNFM(network="vgg19,texture", layers=["relu3_1", "relu3_2", "relu3_3", "relu5_1"])
    assert (loss.source.network, loss.source.stand_in) == ("vgg19", "texture")
    # What the smaller network lacks is its last layer of the block, and each layer is read once.
    assert loss.layers == ("relu3_1", "relu3_2", "relu4_1")
    assert loss.source.file == "texture.safetensors" and len(loss.source.sha256) == 64
    with pytest.raises(FileNotFoundError, match="vgg19"):
        NNFM(network="vgg19")
    with pytest.raises(ValueError, match="no perceptual network"):
        NNFM(network="vgg20,texture")


def test_matched_colours_have_the_moments_of_the_style() -> None:
    content, style = 0.3 + 0.4 * PHOTOGRAPHS[0], 0.35 + 0.3 * STYLE
    pixels = color_map(content, style)(content.movedim(1, -1)).flatten(0, 2)
    wanted = style.movedim(1, -1).flatten(0, 2)
    torch.testing.assert_close(pixels.mean(0), wanted.mean(0), rtol=0, atol=1e-4)
    torch.testing.assert_close(pixels.T.cov(), wanted.T.cov(), rtol=0, atol=1e-4)
    torch.testing.assert_close(color_map(style, style).matrix, torch.eye(3), rtol=0, atol=1e-5)
    flat = color_map(content, torch.full((1, 3, 8, 8), 0.25)).of_images(content)
    torch.testing.assert_close(flat, torch.full_like(flat, 0.25), rtol=0, atol=0.05)
