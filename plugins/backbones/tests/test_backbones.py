"""What the networks do, whatever their weights."""

from typing import Any

import pytest
import torch

from anystyle.branch import ATTRIBUTES
from anystyle.contracts import Backbone
from anystyle.pipeline.load import modules_in_bf16
from anystyle.testing.oracle import hashed
from tests.support.backbone_cases import network, same, views

ALL = ["anysplat", "depth_anything", "styl3r", "stylos"]
ORDERS = {"anysplat": [0, 3, 1, 2], "styl3r": [0, 3, 1, 2], "stylos": [0, 3, 1, 2], "depth_anything": [3, 0, 2, 1]}
"""Orders in which the photographs may be given: of Depth Anything's any view may be the reference."""
FROM_SCRATCH = ["anysplat", "depth_anything"]


@pytest.mark.parametrize("name", ALL)
def test_views_decoded_in_turns_give_the_same_scene_and_gradients(name: str) -> None:
    results, gradients = [], []
    for chunk in (1, 100):
        backbone = network(name, chunk=chunk)
        scene = backbone.encode(views(3, scenes=2, patch=backbone.patch_size))
        results.append((scene.geometry, scene.attributes))
        (scene.attributes.color.mean() + scene.attributes.opacity.mean()).backward()
        gradients.append([parameter.grad for parameter in backbone.gaussian_head.parameters()])
    same(*results, rtol=1e-4, atol=1e-5)
    same(*gradients, rtol=1e-3, atol=1e-5)
    assert any(gradient is not None for gradient in gradients[0])


@torch.no_grad()
@pytest.mark.parametrize("name", ALL)
def test_views_may_be_given_in_any_order(name: str) -> None:
    backbone, order = network(name), ORDERS[name]
    given = views(4, patch=backbone.patch_size)
    scene, other = backbone.encode(given), backbone.encode(given.select(order))
    if scene.stem.reference is not None and other.stem.reference is not None:
        assert order[int(other.stem.reference)] == int(scene.stem.reference)
    named = ([getattr(each.attributes, name) for each in (scene, other)] for name in ATTRIBUTES)
    for one, moved in ((scene.geometry.points(), other.geometry.points()), *named):
        same(one[:, order], moved, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", FROM_SCRATCH)
def test_checkpointing_changes_no_gradient(name: str) -> None:
    gradients = []
    for checkpointing in (False, True):
        backbone = network(name, checkpointing=checkpointing).train()
        features = backbone.aggregator(backbone.embedder(views(2).images))
        sum(tokens.data.square().mean() for tokens in features.values()).backward()
        gradients.append([parameter.grad.clone() for parameter in backbone.aggregator.parameters()])
    same(*gradients, rtol=1e-5, atol=1e-7)


@torch.no_grad()
@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_other_precisions(name: str, dtype: torch.dtype) -> None:
    backbone = network(name)
    given = views(2, patch=backbone.patch_size)
    expected = backbone.encode(given)
    for module in modules_in_bf16("bf16", backbone) if dtype == torch.bfloat16 else [backbone]:
        module.to(dtype)
    scene = backbone.encode(given)
    assert scene.stem.data.dtype == dtype and scene.geometry.depth.dtype == torch.float32
    coarse = 0.1 if dtype == torch.bfloat16 else 1e-4
    torch.testing.assert_close(scene.geometry.points(), expected.geometry.points(), rtol=coarse, atol=coarse)
    torch.testing.assert_close(scene.attributes.opacity.float(), expected.attributes.opacity, rtol=coarse, atol=coarse)
    gaussians = backbone.adapter(scene.attributes, scene.geometry, None)
    assert {getattr(gaussians, name).dtype for name in vars(gaussians)} == {torch.float32}


@torch.no_grad()
@pytest.mark.parametrize("name", FROM_SCRATCH)
def test_autocast_keeps_geometry_in_full_precision(name: str) -> None:
    backbone, given = network(name), views(3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    features = {layer: tokens.with_data(tokens.data.float()) for layer, tokens in scene.features.items()}
    expected = backbone.geometry_head(features, given.images)
    exact = backbone.adapter(scene.attributes, expected, backbone.adapter.cluster(expected, scene.attributes))
    same(scene.geometry, expected, rtol=1e-6, atol=1e-6)
    same(gaussians.means, exact.means, rtol=1e-6, atol=1e-6)
    assert gaussians.harmonics.dtype == torch.float32


class TestScratch:
    """An untrained network shows its photographs on a plane at depth 1."""

    @pytest.fixture(scope="class", params=FROM_SCRATCH)
    @classmethod
    def backbone(cls, request: pytest.FixtureRequest) -> Backbone:
        return network(request.param, init="scratch")

    def test_an_untrained_network_shows_its_photographs(self, backbone: Backbone) -> None:
        with torch.no_grad():
            scene = backbone.encode(views(2))
        color = 0.5 + 0.28209479 * scene.attributes.color[..., 0]
        torch.testing.assert_close(color.movedim(-1, 2), scene.views.images, rtol=0, atol=0.01)
        torch.testing.assert_close(scene.geometry.depth, torch.ones_like(scene.geometry.depth), rtol=0, atol=0.1)
        assert (scene.cameras.world_from_camera - torch.eye(4)).abs().max() < 0.2
        fov = 2 * torch.atan(28 / 2 / scene.cameras.intrinsics[..., 1, 1]).rad2deg()
        torch.testing.assert_close(fov, torch.full_like(fov, 55.0), rtol=0, atol=5)

    def test_every_parameter_learns_within_two_steps(self, backbone: Backbone) -> None:
        optimizer = torch.optim.Adam(backbone.train().parameters(), lr=1e-3)
        for _ in range(2):
            scene = backbone.encode(views(3))
            gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
            optimizer.zero_grad()
            intrinsics = scene.cameras.intrinsics / 50
            parts = [scene.geometry.depth, scene.geometry.confidence, intrinsics, *vars(gaussians).values()]
            sum((part * hashed(index, part.shape, -1, 1)).sum() for index, part in enumerate(parts)).backward()
            optimizer.step()
        assert [n for n, p in backbone.named_parameters() if p.grad is None or not p.grad.any()] == []


LAYERED = [
    ({"heads": 3}, "dim 32 with 3 heads; the channels of a head must be a multiple of 4"),
    ({"taps": (5, 6, 7)}, r"give four layers from -?\d on in rising order"),
    ({"taps": (3, 4, 5, 6)}, r"the last is depth - 1 = \d"),
    ({"taps": (5, 4, 6, 7)}, "in rising order"),
    ({"depth_features": 20}, "a decoder of 20 features"),
    ({"gaussian_channels": (8, 8, 8, 9)}, "levels multiples of 4"),
]
REFUSED = [(name, *case) for name in FROM_SCRATCH for case in LAYERED] + [
    ("anysplat", {"camera_heads": 5}, "camera_heads is 5"),
    ("depth_anything", {"alternate_from": 0}, "give a block from 1 to depth - 1 = 7"),
    ("depth_anything", {"alternate_from": 8}, "give a block from 1 to depth - 1 = 7"),
    ("depth_anything", {"taps": (2, 5, 6, 7)}, "give four layers from 3 on"),
    ("depth_anything", {"gaussian_features": 16, "init": "scratch"}, "init=scratch needs 24"),
    ("styl3r", {"heads": 3}, "heads is 3, of 32 channels"),
    ("styl3r", {"decoder_heads": 5}, "decoder_heads is 5, of 24 channels"),
]


@pytest.mark.parametrize(("name", "options", "message"), REFUSED)
def test_options_that_contradict_each_other(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        network(name, **options)
