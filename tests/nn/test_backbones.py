"""What the backbones of the repository do, whatever their weights."""

from typing import Any

import pytest
import torch

from anystyle.contracts import Backbone
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.testing.oracle import hashed
from anystyle.types import Scene
from tests.support.backbone_cases import network, same, views

NAMES = ["anysplat", "depth_anything"]


@pytest.fixture(scope="module", params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def backbone(name: str) -> Backbone:
    return network(name)


@pytest.mark.parametrize("chunk", [1, 2])
def test_views_decoded_in_turns_give_the_same_scene(name: str, chunk: int) -> None:
    backbone, given = network(name), views(3, scenes=2)
    features = backbone.aggregator(backbone.embedder(given.images))
    results = []
    for size in (chunk, 100):
        backbone.gaussian_head.chunk = backbone.geometry_head.chunk = size
        results.append((backbone.geometry_head(features, given.images), backbone.gaussian_head(features, given.images)))
    same(*results, rtol=1e-4, atol=1e-5)
    results[0][1].color.sum().backward()  # joined results carry gradients
    assert all(parameter.grad is not None for parameter in backbone.gaussian_head.direct.parameters())


def test_checkpointing_changes_no_gradient(name: str) -> None:
    gradients = []
    for checkpointing in (False, True):
        backbone = network(name, checkpointing=checkpointing).train()
        features = backbone.aggregator(backbone.embedder(views(2).images))
        sum(tokens.data.square().mean() for tokens in features.values()).backward()
        gradients.append([parameter.grad.clone() for parameter in backbone.aggregator.parameters()])
    same(*gradients, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_other_precisions(name: str, dtype: torch.dtype) -> None:
    backbone = network(name, **({"fuse": False} if name == "anysplat" else {}))
    with torch.no_grad():
        expected = backbone.encode(views(2))
        scene = backbone.to(dtype).encode(views(2))
    assert scene.stem.data.dtype == dtype and scene.geometry.depth.dtype == torch.float32
    coarse = 0.1 if dtype == torch.bfloat16 else 1e-4
    torch.testing.assert_close(scene.geometry.depth, expected.geometry.depth, rtol=coarse, atol=coarse)
    torch.testing.assert_close(scene.attributes.opacity.float(), expected.attributes.opacity, rtol=coarse, atol=coarse)
    gaussians = backbone.adapter(scene.attributes, scene.geometry, None)
    assert {getattr(gaussians, name).dtype for name in vars(gaussians)} == {torch.float32}


def test_autocast_keeps_geometry_in_full_precision(backbone: Backbone) -> None:
    given = views(3)
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    with torch.no_grad():
        features = {layer: tokens.with_data(tokens.data.float()) for layer, tokens in scene.features.items()}
        expected = backbone.geometry_head(features, given.images)
        exact = backbone.adapter(scene.attributes, expected, backbone.adapter.cluster(expected, scene.attributes))
    same(scene.geometry, expected, rtol=1e-6, atol=1e-6)
    same(gaussians.means, exact.means, rtol=1e-6, atol=1e-6)
    assert gaussians.harmonics.dtype == torch.float32


class TestScratch:
    """An untrained network shows its photographs on a plane at depth 1."""

    @pytest.fixture(scope="class")
    @classmethod
    def scene(cls, name: str) -> Scene:
        with torch.no_grad():
            return network(name, init="scratch").encode(views(2))

    def test_colors_are_those_of_the_pixels(self, scene: Scene) -> None:
        color = 0.5 + 0.28209479 * scene.attributes.color[..., 0]
        torch.testing.assert_close(color.movedim(-1, 2), scene.views.images, rtol=0, atol=0.01)

    def test_geometry(self, scene: Scene) -> None:
        torch.testing.assert_close(scene.geometry.depth, torch.ones_like(scene.geometry.depth), rtol=0, atol=0.1)
        assert (scene.cameras.world_from_camera - torch.eye(4)).abs().max() < 0.2
        fov = 2 * torch.atan(28 / 2 / scene.cameras.intrinsics[..., 1, 1]).rad2deg()
        torch.testing.assert_close(fov, torch.full_like(fov, 55.0), rtol=0, atol=5)

    def test_every_parameter_learns_within_two_steps(self, name: str) -> None:
        backbone = network(name, init="scratch").train()
        optimizer = torch.optim.Adam(backbone.parameters(), lr=1e-3)
        for _ in range(2):
            scene = backbone.encode(views(3))
            gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
            optimizer.zero_grad()
            intrinsics = scene.cameras.intrinsics / 50
            parts = [scene.geometry.depth, scene.geometry.confidence, intrinsics, *vars(gaussians).values()]
            loss = sum((part * hashed(index, part.shape, -1, 1)).sum() for index, part in enumerate(parts))
            loss.backward()
            optimizer.step()
        assert [n for n, p in backbone.named_parameters() if p.grad is None or not p.grad.any()] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heads": 3}, "dim 32 with 3 heads; the channels of a head must be a multiple of 4"),
        ({"taps": (5, 6, 7)}, r"give four layers from -?\d on in rising order"),
        ({"taps": (3, 4, 5, 6)}, r"the last is depth - 1 = \d"),
        ({"taps": (5, 4, 6, 7)}, "in rising order"),
        ({"depth_features": 20}, "a decoder of 20 features"),
        ({"gaussian_channels": (8, 8, 8, 9)}, "levels multiples of 4"),
    ],
)
def test_options_that_contradict_each_other(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        network(name, **options)


@pytest.mark.parametrize("name", NAMES)
def test_a_chunk_of_nothing_is_refused_where_a_configuration_is_built(name: str) -> None:
    with pytest.raises(ValueError, match="chunk=0: expected int >= 1"):
        build(Backbone, {"_target_": catalog().find("backbone", name).path, "chunk": 0})
