"""What holds for the network whatever its weights: sites, style at every placement, and Gaussians without training."""

import pytest
import torch

from anystyle.geometry.harmonics import CONSTANT
from anystyle.testing.oracle import hashed
from anystyle.types import Scene
from anystyle_backbones.mapanything import MapAnything, heads
from anystyle_backbones.pointmaps import lens_of, renderable
from tests.support import mapanything_reference as reference
from tests.support.backbone_cases import PLACEMENTS, check_placement, network, same, views


@pytest.fixture(scope="module")
def backbone() -> MapAnything:
    torch.manual_seed(0)
    backbone = MapAnything(**reference.TINY)
    backbone.load_reference(reference.tiny_weights())
    backbone.freeze()
    return backbone


@pytest.fixture(scope="module")
def scene(backbone: MapAnything) -> Scene:
    return backbone.encode(views(2))


def test_the_published_sites() -> None:
    with torch.device("meta"):
        sites = MapAnything().sites
    tapped = [site.name for site in sites if site.tapped]
    assert tapped[:4] == [f"aggregator/{layer}" for layer in (0, 7, 11, 15)] and len(sites) == 21
    tokens = [(f"head/tokens/{level}", 1536) for level in range(4)]
    assert [(site.name, site.dim) for site in sites[16:]] == [*tokens, ("head/direct", 128)]


@pytest.mark.parametrize("name", PLACEMENTS)
def test_style_enters_at_every_placement(backbone: MapAnything, scene: Scene, name: str) -> None:
    check_placement(backbone, scene, name, least=1e-4)


def test_untrained_gaussians_are_the_photographs_at_the_published_points(backbone: MapAnything, scene: Scene) -> None:
    gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    assert scene.geometry.pointmap is not None and scene.clusters is None
    assert torch.equal(gaussians.means, scene.geometry.pointmap.flatten(1, 3))
    color = 0.5 + CONSTANT * scene.attributes.color[..., 0]
    torch.testing.assert_close(color.movedim(-1, 2), scene.views.images, rtol=0, atol=0.05)
    torch.testing.assert_close(gaussians.opacities, torch.full_like(gaussians.opacities, 0.9), rtol=0, atol=0.02)
    focal = scene.cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
    side = scene.geometry.depth.abs() * (1 / focal).mean(-1)[..., None, None]
    sides = side.flatten(1)[..., None].expand_as(gaussians.scales)
    torch.testing.assert_close(gaussians.scales, 0.5 * sides, rtol=0.1, atol=0)


def test_fused_gaussians_are_fewer(scene: Scene) -> None:
    fused = network("mapanything", fuse=True, voxel_size=0.5)
    clusters = fused.adapter.cluster(scene.geometry, scene.attributes)
    assert clusters is not None and int(clusters.valid.sum()) < scene.geometry.depth.numel() / 2


def test_a_lens_of_exact_rays_is_their_camera_s() -> None:
    """Half a pixel between the indices of pixels and their places is the head's to add."""
    rows, columns = torch.meshgrid(torch.arange(28.0), torch.arange(42.0), indexing="ij")
    rays = torch.stack([(columns - 20.0) / 30, (rows - 13.0) / 40, torch.ones_like(rows)], dim=-1)
    torch.testing.assert_close(lens_of(rays[None, None]), torch.tensor([[[30.0, 40.0, 20.0, 13.0]]]))


def test_points_of_pinhole_rays_are_seen_at_the_middle_of_their_pixels(
    backbone: MapAnything, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the pose and the scale."""
    given = views(2)
    rows, columns = torch.meshgrid(torch.arange(28.0), torch.arange(42.0), indexing="ij")
    rays = torch.stack([(columns - 20.0) / 30, (rows - 13.0) / 40, torch.ones_like(rows)], dim=-1)
    raw = torch.cat([rays.expand(1, 2, -1, -1, -1), hashed(7, (1, 2, 28, 42, 3), -1, 1)], dim=-1)
    monkeypatch.setattr(heads, "decoded_maps", lambda *_, **__: raw)
    with torch.no_grad():
        geometry = backbone.geometry_head(backbone.aggregator(backbone.embedder(given.images)), given.images)
    assert geometry.pointmap is not None
    pose = geometry.cameras.camera_from_world[:, :, None, None]
    local = (pose[..., :3, :3] @ geometry.pointmap[..., None])[..., 0] + pose[..., :3, 3]
    projected = (geometry.cameras.intrinsics[:, :, None, None] @ local[..., None])[..., 0]
    seen = projected[..., :2] / projected[..., 2:]
    torch.testing.assert_close(seen, torch.stack([columns, rows], dim=-1).expand_as(seen) + 0.5, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(local[..., 2], geometry.depth, rtol=1e-4, atol=1e-4)


def test_rays_of_no_camera_give_one_that_renders() -> None:
    size = (28, 42)
    for rays in (torch.zeros(1, 1, *size, 3), torch.ones(1, 1, *size, 3), hashed(3, (1, 1, *size, 3), -1, 1)):
        lens = renderable(lens_of(rays), size)
        assert bool(lens.isfinite().all()) and bool((lens[..., :2] > 0).all())
    given = torch.tensor([[[30.0, 40.0, 20.0, 13.0]]])
    assert torch.equal(renderable(given, size), given)


def test_later_views_may_be_given_in_any_order() -> None:
    backbone, given, order = network("mapanything"), views(4), [0, 3, 1, 2]
    with torch.no_grad():
        one, other = backbone.encode(given), backbone.encode(given.select(order))
    same(one.geometry.depth[:, order], other.geometry.depth, rtol=1e-3, atol=1e-4)
    same(one.attributes.color[:, order], other.attributes.color, rtol=1e-3, atol=1e-4)


def test_every_parameter_learns_within_two_steps() -> None:
    backbone = network("mapanything").train()
    optimizer = torch.optim.Adam(backbone.parameters(), lr=1e-3)
    for _ in range(2):
        scene = backbone.encode(views(3))
        gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
        optimizer.zero_grad()
        parts = [scene.geometry.depth, scene.geometry.confidence, *vars(gaussians).values()]
        sum((part * hashed(index, part.shape, -1, 1)).sum() for index, part in enumerate(parts)).backward()
        optimizer.step()
    assert [n for n, p in backbone.named_parameters() if p.grad is None or not p.grad.any()] == []
