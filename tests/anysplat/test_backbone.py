"""What holds for the network whatever its weights."""

import math
from pathlib import Path
from typing import Any

import pytest
import torch

from anystyle.types import Scene, Tokens, Views
from anystyle_anysplat import AnySplat
from oracle import hashed, smooth_image

EXAMPLE = AnySplat.example(Path())


def network(**options: Any) -> AnySplat:
    torch.manual_seed(0)
    backbone = AnySplat(**(EXAMPLE | options))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in backbone.parameters():
            if options.get("init") != "scratch":
                parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    return backbone.eval()


@pytest.fixture(scope="module")
def backbone() -> AnySplat:
    return network()


def views(count: int, scenes: int = 1, size: tuple[int, int] = (28, 42)) -> Views:
    return Views(smooth_image(count, (scenes, count, 3, *size)))


def same(left: Any, right: Any, **tolerance: float) -> None:
    for one, other in zip(torch.utils._pytree.tree_leaves(left), torch.utils._pytree.tree_leaves(right), strict=True):
        if isinstance(one, torch.Tensor):
            torch.testing.assert_close(one, other, **tolerance)


class TestSites:
    def test_every_layer_and_head_site_in_order(self, backbone: AnySplat) -> None:
        names = [site.name for site in backbone.sites]
        assert names == [
            *(f"aggregator/{layer}" for layer in range(5)),
            *(f"head/tokens/{level}" for level in range(4)),
            "head/direct",
        ]

    def test_the_published_sites_are_the_tapped_ones(self) -> None:
        with torch.device("meta"):
            sites = AnySplat().sites
        tapped = [site.name for site in sites if site.tapped]
        assert tapped[:5] == [f"aggregator/{layer}" for layer in (0, 4, 11, 17, 23)]
        assert {site.dim for site in sites[:24]} == {1024}
        assert [(site.name, site.dim) for site in sites[24:]] == [
            *((f"head/tokens/{level}", 2048) for level in range(4)),
            ("head/direct", 128),
        ]

    def test_each_is_visited_once_with_tokens_of_its_width(self, backbone: AnySplat) -> None:
        seen: list[tuple[str, int, int, int]] = []

        def inject(site: str, tokens: Tokens) -> Tokens:
            rows, columns = tokens.grid
            assert tokens.data.shape[:3] == (2, 3, tokens.special + rows * columns)
            seen.append((site, tokens.data.shape[-1], tokens.special, rows))
            return tokens

        images = views(3, scenes=2).images
        with torch.no_grad():
            features = backbone.aggregator(backbone.embedder(images), inject)
            backbone.gaussian_head.chunk = 8
            backbone.gaussian_head(features, images, inject)
        assert [(name, dim) for name, dim, _, _ in seen] == [(site.name, site.dim) for site in backbone.sites]
        assert {special for _, _, special, _ in seen[:5]} == {5} and {special for *_, special, _ in seen[5:]} == {0}
        assert [rows for *_, rows in seen] == [2] * 9 + [28]

    def test_pixels_as_tokens_are_the_image_in_row_major_order(self, backbone: AnySplat) -> None:
        images = views(2).images
        caught: dict[str, Tokens] = {}

        def inject(site: str, tokens: Tokens) -> Tokens:
            caught[site] = tokens
            return tokens

        with torch.no_grad():
            backbone.gaussian_head(backbone.aggregator(backbone.embedder(images)), images, inject)
            expected = backbone.gaussian_head.direct(images[0]).relu()
        direct = caught["head/direct"]
        torch.testing.assert_close(direct.data[0].mT.unflatten(-1, direct.grid), expected)

    def test_what_is_added_at_a_site_changes_the_result(self, backbone: AnySplat) -> None:
        images = views(2).images
        with torch.no_grad():
            stem = backbone.embedder(images)
            plain = backbone.gaussian_head(backbone.aggregator(stem), images)
            for site in backbone.sites:
                shift = torch.randn(site.dim, generator=torch.Generator().manual_seed(3))

                def inject(name: str, tokens: Tokens, target: str = site.name, shift: torch.Tensor = shift) -> Tokens:
                    return tokens.with_patches(tokens.patches + shift) if name == target else tokens

                styled = backbone.gaussian_head(backbone.aggregator(stem, inject), images, inject)
                assert not torch.allclose(styled.color, plain.color, atol=1e-4), site.name


class TestSymmetries:
    """The first view's camera token differs; all other views are treated alike."""

    def test_later_views_may_be_given_in_any_order(self, backbone: AnySplat) -> None:
        given = views(4)
        order = [0, 3, 1, 2]
        with torch.no_grad():
            one, other = backbone.encode(given), backbone.encode(given.select(order))
        same(one.geometry.depth[:, order], other.geometry.depth, rtol=1e-3, atol=1e-4)
        same(one.attributes.color[:, order], other.attributes.color, rtol=1e-3, atol=1e-4)
        same(one.cameras.world_from_camera[:, order], other.cameras.world_from_camera, rtol=1e-3, atol=1e-4)

    def test_the_first_view_is_special(self, backbone: AnySplat) -> None:
        given = views(3)
        with torch.no_grad():
            one, other = backbone.encode(given), backbone.encode(given.select([1, 0, 2]))
        assert not torch.allclose(one.features[4].data[:, [1, 0, 2]], other.features[4].data, rtol=0.01, atol=0.01)

    def test_scenes_of_a_batch_do_not_see_each_other(self, backbone: AnySplat) -> None:
        both = views(2, scenes=2)
        with torch.no_grad():
            scenes = backbone.encode(both)
            for row in range(2):
                alone = backbone.encode(Views(both.images[row : row + 1]))
                same(scenes.attributes.map(lambda t, row=row: t[row : row + 1]), alone.attributes, rtol=1e-3, atol=1e-4)
                count = alone.clusters.means.shape[1]  # type: ignore[union-attr]
                assert int(scenes.clusters.valid[row].sum()) == pytest.approx(count, abs=2)  # type: ignore[union-attr]


@pytest.mark.parametrize("chunk", [1, 2])
def test_views_decoded_in_turns_give_the_same_scene(backbone: AnySplat, chunk: int) -> None:
    given = views(3, scenes=2)
    features = backbone.aggregator(backbone.embedder(given.images))
    results = []
    for size in (chunk, 100):
        backbone.gaussian_head.chunk = backbone.geometry_head.chunk = size
        results.append((backbone.geometry_head(features, given.images), backbone.gaussian_head(features, given.images)))
    same(*results, rtol=1e-4, atol=1e-5)
    results[0][1].color.sum().backward()  # joined results carry gradients
    assert backbone.gaussian_head.direct.weight.grad is not None
    backbone.zero_grad()


def test_encoding_twice_gives_the_same_bits(backbone: AnySplat) -> None:
    with torch.no_grad():
        same(backbone.encode(views(2)), backbone.encode(views(2)), rtol=0, atol=0)


def test_checkpointing_changes_no_gradient() -> None:
    gradients = []
    for checkpointing in (False, True):
        backbone = network(checkpointing=checkpointing).train()
        features = backbone.aggregator(backbone.embedder(views(2).images))
        sum(tokens.data.square().mean() for tokens in features.values()).backward()  # type: ignore[union-attr]
        gradients.append([parameter.grad.clone() for parameter in backbone.aggregator.parameters()])  # type: ignore[union-attr]
    same(*gradients, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_other_precisions(dtype: torch.dtype) -> None:
    backbone = network(fuse=False)
    with torch.no_grad():
        expected = backbone.encode(views(2))
        scene = backbone.to(dtype).encode(views(2))
    assert scene.stem.data.dtype == dtype and scene.geometry.depth.dtype == torch.float32
    coarse = 0.1 if dtype == torch.bfloat16 else 1e-4
    torch.testing.assert_close(scene.geometry.depth, expected.geometry.depth, rtol=coarse, atol=coarse)
    torch.testing.assert_close(scene.attributes.opacity.float(), expected.attributes.opacity, rtol=coarse, atol=coarse)


def test_autocast_keeps_geometry_in_full_precision(backbone: AnySplat) -> None:
    given = views(2)
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    with torch.no_grad():
        features = {layer: tokens.with_data(tokens.data.float()) for layer, tokens in scene.features.items()}
        expected = backbone.geometry_head(features, given.images)
        clusters = backbone.adapter.cluster(expected, scene.attributes)
    same(scene.geometry, expected, rtol=1e-6, atol=1e-6)
    assert clusters is not None and gaussians.harmonics.dtype == torch.float32
    torch.testing.assert_close(gaussians.means, clusters.means, rtol=1e-6, atol=1e-6)


class TestScratch:
    """An untrained network shows its photographs on a plane at depth 1."""

    @pytest.fixture(scope="class")
    @classmethod
    def scene(cls) -> Scene:
        with torch.no_grad():
            return network(init="scratch").encode(views(2))

    def test_colors_are_those_of_the_pixels(self, scene: Scene) -> None:
        color = 0.5 + 0.28209479 * scene.attributes.color[..., 0]
        torch.testing.assert_close(color.movedim(-1, 2), scene.views.images, rtol=0, atol=0.01)

    def test_geometry(self, scene: Scene) -> None:
        torch.testing.assert_close(scene.geometry.depth, torch.ones_like(scene.geometry.depth), rtol=0, atol=0.1)
        turn = scene.cameras.world_from_camera - torch.eye(4)
        assert turn.abs().max() < 0.2
        fov = 2 * torch.atan(28 / 2 / scene.cameras.intrinsics[..., 1, 1]).rad2deg()
        torch.testing.assert_close(fov, torch.full_like(fov, 55.0), rtol=0, atol=5)

    def test_gaussians_are_opaque_and_a_pixel_wide(self, scene: Scene) -> None:
        backbone = network(init="scratch", fuse=False)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, None)
        footprint = 2 * math.tan(math.radians(55) / 2) / EXAMPLE["resolution"]
        assert gaussians.scales.mean().item() == pytest.approx(0.5 * footprint, rel=0.15)
        assert gaussians.opacities.mean().item() == pytest.approx(0.9, abs=0.02)
        assert gaussians.rotations[..., 0].min() > 0.95

    def test_every_parameter_learns_within_two_steps(self) -> None:
        backbone = network(init="scratch").train()
        optimizer = torch.optim.Adam(backbone.parameters(), lr=1e-3)
        for _ in range(2):
            scene = backbone.encode(views(2))
            gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
            optimizer.zero_grad()
            parts = [
                scene.geometry.depth,
                scene.geometry.confidence,
                scene.cameras.intrinsics / 50,
                *vars(gaussians).values(),
            ]
            loss = sum((part * hashed(place, part.shape, -1, 1)).sum() for place, part in enumerate(parts))
            loss.backward()  # type: ignore[union-attr]
            optimizer.step()
        silent = [n for n, p in backbone.named_parameters() if p.grad is None or not p.grad.any()]
        assert silent == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heads": 3}, "dim 32 with 3 heads; the channels of a head must be a multiple of 4"),
        ({"camera_heads": 5}, "camera_heads is 5"),
        ({"taps": (1, 2, 3)}, "give four layers in rising order"),
        ({"taps": (0, 1, 2, 3)}, "the last is depth - 1 = 4"),
        ({"taps": (2, 1, 3, 4)}, "in rising order"),
        ({"depth_features": 20}, "a decoder of 20 features"),
        ({"gaussian_channels": (8, 8, 8, 9)}, "levels multiples of 4"),
        ({"chunk": 0}, "chunk is 0"),
    ],
)
def test_options_that_contradict_each_other(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AnySplat(**(EXAMPLE | options))
