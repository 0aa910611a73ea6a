"""What holds for the network whatever its weights."""

import math
from pathlib import Path
from typing import Any

import pytest
import torch

from anystyle.types import Scene, Tokens, Views
from anystyle_depth_anything import DepthAnything
from oracle import hashed, smooth_image

EXAMPLE = DepthAnything.example(Path())


def network(**options: Any) -> DepthAnything:
    torch.manual_seed(0)
    backbone = DepthAnything(**(EXAMPLE | options))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in backbone.parameters():
            if options.get("init") != "scratch":
                parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    return backbone.eval()


@pytest.fixture(scope="module")
def backbone() -> DepthAnything:
    return network()


def views(count: int, scenes: int = 1, size: tuple[int, int] = (28, 42)) -> Views:
    return Views(smooth_image(count, (scenes, count, 3, *size)))


def same(left: Any, right: Any, **tolerance: float) -> None:
    for one, other in zip(torch.utils._pytree.tree_leaves(left), torch.utils._pytree.tree_leaves(right), strict=True):
        if isinstance(one, torch.Tensor):
            torch.testing.assert_close(one, other, **tolerance)


class TestSites:
    def test_the_largest_network_s(self) -> None:
        with torch.device("meta"):
            sites = DepthAnything().sites
        assert [site.name for site in sites[:27]] == [f"aggregator/{layer}" for layer in range(13, 40)]
        tapped = [site.name for site in sites[:27] if site.tapped]
        assert tapped == [f"aggregator/{layer}" for layer in (13, 18, 26, 32, 38)]
        assert {site.dim for site in sites[:27]} == {1536}
        assert [(site.name, site.dim, site.tapped) for site in sites[27:]] == [
            *((f"head/tokens/{level}", 3072, True) for level in range(4)),
            ("head/direct", 128, True),
        ]

    def test_each_is_visited_once_with_tokens_of_its_width(self, backbone: DepthAnything) -> None:
        seen: list[tuple[str, int, int]] = []

        def inject(site: str, tokens: Tokens) -> Tokens:
            rows, columns = tokens.grid
            assert tokens.data.shape[:3] == (2, 3, tokens.special + rows * columns)
            seen.append((site, tokens.data.shape[-1], tokens.special))
            return tokens

        images = views(3, scenes=2).images
        with torch.no_grad():
            features = backbone.aggregator(backbone.embedder(images), inject)
            backbone.gaussian_head.chunk = 8
            backbone.gaussian_head(features, images, inject)
        assert [(name, dim) for name, dim, _ in seen] == [(site.name, site.dim) for site in backbone.sites]
        assert {special for *_, special in seen[:5]} == {1} and {special for *_, special in seen[5:]} == {0}

    def test_a_style_at_a_tapped_site_is_in_both_halves_of_what_heads_read(self, backbone: DepthAnything) -> None:
        stem = backbone.embedder(views(2).images)
        dim = stem.data.shape[-1]
        shift = hashed(3, (dim,), -1, 1)

        def inject(site: str, tokens: Tokens) -> Tokens:
            return tokens.with_patches(tokens.patches + shift) if site == "aggregator/6" else tokens

        with torch.no_grad():
            plain, styled = backbone.aggregator(stem), backbone.aggregator(stem, inject)
        for layer in (4, 5):
            assert torch.equal(plain[layer].data, styled[layer].data)
        change = (styled[7].patches - plain[7].patches).abs()
        assert change[..., :dim].mean() > 0.01 and change[..., dim:].mean() > 0.01

    def test_pixels_as_tokens_are_the_image_in_row_major_order(self, backbone: DepthAnything) -> None:
        images = views(2).images
        caught: dict[str, Tokens] = {}

        def inject(site: str, tokens: Tokens) -> Tokens:
            caught[site] = tokens
            return tokens

        with torch.no_grad():
            backbone.gaussian_head(backbone.aggregator(backbone.embedder(images)), images, inject)
            mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
            normal = (images[0] - mean[:, None, None]) / std[:, None, None]
            expected = backbone.gaussian_head.direct(normal)
        direct = caught["head/direct"]
        torch.testing.assert_close(direct.data[0].mT.unflatten(-1, direct.grid), expected)


class TestOrder:
    """Features are in the order of the views, whichever of them is the reference."""

    def test_views_may_be_given_in_any_order(self, backbone: DepthAnything) -> None:
        given, order = views(5), [3, 0, 4, 1, 2]
        with torch.no_grad():
            one, other = backbone.encode(given), backbone.encode(given.select(order))
        assert one.stem.reference is not None and other.stem.reference is not None
        assert order[int(other.stem.reference)] == int(one.stem.reference)
        same(one.geometry.depth[:, order], other.geometry.depth, rtol=1e-3, atol=1e-4)
        same(one.attributes.color[:, order], other.attributes.color, rtol=1e-3, atol=1e-4)
        same(one.cameras.world_from_camera[:, order], other.cameras.world_from_camera, rtol=1e-3, atol=1e-4)

    def test_the_reference_s_place_is_no_matter(self) -> None:
        backbone = network(reference="middle")
        given, order = views(3), [1, 0, 2]
        with torch.no_grad():
            centered = backbone.encode(given)
            backbone.embedder.reference = "first"
            first = backbone.encode(given.select(order))
        assert first.stem.reference is None
        same(centered.geometry.depth[:, order], first.geometry.depth, rtol=1e-4, atol=1e-5)
        same(centered.features[7].data[:, order], first.features[7].data, rtol=1e-4, atol=1e-5)

    def test_the_reference_is_special(self, backbone: DepthAnything) -> None:
        given = views(3)
        results = []
        for strategy in ("first", "middle"):
            backbone.embedder.reference = strategy  # type: ignore[assignment]
            with torch.no_grad():
                results.append(backbone.encode(given).features[7].data)
        backbone.embedder.reference = "saddle_balanced"
        assert not torch.allclose(*results, rtol=0.01, atol=0.01)

    def test_scenes_of_a_batch_choose_by_themselves(self, backbone: DepthAnything) -> None:
        both = views(4, scenes=2)
        with torch.no_grad():
            scenes = backbone.encode(both)
            for row in range(2):
                alone = backbone.encode(Views(both.images[row : row + 1]))
                assert scenes.stem.reference is not None and alone.stem.reference is not None
                assert scenes.stem.reference[row] == alone.stem.reference[0]
                same(scenes.attributes.map(lambda t, row=row: t[row : row + 1]), alone.attributes, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("chunk", [1, 2])
def test_views_decoded_in_turns_give_the_same_scene(backbone: DepthAnything, chunk: int) -> None:
    given = views(3, scenes=2)
    features = backbone.aggregator(backbone.embedder(given.images))
    results = []
    for size in (chunk, 100):
        backbone.gaussian_head.chunk = backbone.geometry_head.chunk = size
        head = backbone.geometry_head
        results.append(
            (head(features, given.images), head.rays(features), backbone.gaussian_head(features, given.images))
        )
    same(*results, rtol=1e-4, atol=1e-5)


def test_encoding_twice_gives_the_same_bits(backbone: DepthAnything) -> None:
    with torch.no_grad():
        same(backbone.encode(views(3)), backbone.encode(views(3)), rtol=0, atol=0)


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
    backbone = network()
    with torch.no_grad():
        expected = backbone.encode(views(2))
        scene = backbone.to(dtype).encode(views(2))
    assert scene.stem.data.dtype == dtype and scene.geometry.depth.dtype == torch.float32
    coarse = 0.1 if dtype == torch.bfloat16 else 1e-4
    torch.testing.assert_close(scene.geometry.depth, expected.geometry.depth, rtol=coarse, atol=coarse)
    torch.testing.assert_close(scene.attributes.opacity.float(), expected.attributes.opacity, rtol=coarse, atol=coarse)
    gaussians = backbone.adapter(scene.attributes, scene.geometry, None)
    assert {getattr(gaussians, name).dtype for name in vars(gaussians)} == {torch.float32}


def test_autocast_keeps_geometry_in_full_precision(backbone: DepthAnything) -> None:
    given = views(3)
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        scene = backbone.encode(given)
        gaussians = backbone.adapter(scene.attributes, scene.geometry, None)
    with torch.no_grad():
        features = {layer: tokens.with_data(tokens.data.float()) for layer, tokens in scene.features.items()}
        expected = backbone.geometry_head(features, given.images)
        exact = backbone.adapter(scene.attributes, expected, None)
    same(scene.geometry, expected, rtol=1e-6, atol=1e-6)
    same(gaussians, exact, rtol=1e-6, atol=1e-6)


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
        gaussians = network(init="scratch").adapter(scene.attributes, scene.geometry, None)
        lens = scene.cameras.intrinsics
        footprint = 0.5 * (1 / lens[..., 0, 0] + 1 / lens[..., 1, 1]).mean().item()
        assert gaussians.scales.mean().item() == pytest.approx(0.5 * footprint, rel=0.15)
        assert gaussians.opacities.mean().item() == pytest.approx(0.9, abs=0.02)
        assert math.isfinite(gaussians.means.sum().item())

    def test_every_parameter_learns_within_two_steps(self) -> None:
        # Cameras that are not given, and rays, are no part of encoding.
        backbone = network(init="scratch", camera_encoder_depth=0, rays=False).train()
        optimizer = torch.optim.Adam(backbone.parameters(), lr=1e-3)
        for _ in range(2):
            scene = backbone.encode(views(3))
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
        # The class token's place is taken by the camera token, after it has been seen by the embedder's blocks.
        assert silent == []


def test_rays_need_their_chain() -> None:
    backbone = network(rays=False)
    features = backbone.aggregator(backbone.embedder(views(1).images))
    with pytest.raises(ValueError, match="rays=true"):
        backbone.geometry_head.rays(features)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heads": 3}, "dim 32 with 3 heads; the channels of a head must be a multiple of 4"),
        ({"camera_encoder_heads": 5}, "camera_encoder_heads is 5"),
        ({"alternate_from": 0}, "give a block from 1 to depth - 1 = 7"),
        ({"alternate_from": 8}, "give a block from 1 to depth - 1 = 7"),
        ({"taps": (5, 6, 7)}, "give four layers in rising order"),
        ({"taps": (2, 5, 6, 7)}, "from alternate_from = 3 on"),
        ({"taps": (3, 4, 5, 6)}, "the last is depth - 1 = 7"),
        ({"depth_features": 20}, "a decoder of 20 features"),
        ({"gaussian_channels": (8, 8, 8, 9)}, "levels multiples of 4"),
        ({"gaussian_features": 16}, "init=scratch needs 24"),
        ({"chunk": 0}, "chunk is 0"),
    ],
)
def test_options_that_contradict_each_other(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DepthAnything(**(EXAMPLE | options))


def test_images_whose_sides_are_no_multiples_are_refused(backbone: DepthAnything) -> None:
    with pytest.raises(ValueError, match="30x42 pixels; both sides must be multiples of 14"):
        backbone.encode(views(1, size=(30, 42)))
