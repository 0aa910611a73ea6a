"""What holds for the network whatever its weights, and with the golden's: sites, style at every placement, fusion."""

from pathlib import Path

import pytest
import torch

from anystyle_backbones.worldmirror import WorldMirror
from tests.support import worldmirror_reference as reference
from tests.support.backbone_cases import PLACEMENTS, check_placement, network, same, views

EXAMPLE = WorldMirror.example(Path())


@pytest.fixture(scope="module")
def backbone() -> WorldMirror:
    backbone = WorldMirror(**reference.TINY)
    backbone.load_reference(reference.tiny_weights())
    backbone.freeze()
    return backbone


def test_the_published_sites_are_those_of_anysplat() -> None:
    with torch.device("meta"):
        sites = WorldMirror().sites
    tapped = [site.name for site in sites if site.tapped]
    assert tapped[:5] == [f"aggregator/{layer}" for layer in (0, 4, 11, 17, 23)] and len(sites) == 29
    tokens = [(f"head/tokens/{level}", 2048) for level in range(4)]
    assert [(site.name, site.dim) for site in sites[24:]] == [*tokens, ("head/direct", 128)]


@pytest.mark.parametrize("name", PLACEMENTS)
def test_style_enters_at_every_placement(backbone: WorldMirror, name: str) -> None:
    check_placement(backbone, backbone.encode(views(2)), name, least=0.01)


def test_pixels_alone_have_an_opacity_of_their_own(backbone: WorldMirror) -> None:
    assert torch.equal(*(getattr(backbone.encode(views(2)).attributes, name) for name in ("opacity", "confidence")))
    unfused = network("worldmirror", fuse=False)
    with torch.no_grad():
        scene = unfused.encode(views(2))
    assert scene.clusters is None and not torch.equal(scene.attributes.opacity, scene.attributes.confidence)


def test_points_are_on_the_rays_of_corners(backbone: WorldMirror) -> None:
    geometry = backbone.encode(views(2)).geometry
    assert geometry.pointmap is not None
    pose = geometry.cameras.camera_from_world[:, :, None, None]
    local = (pose[..., :3, :3] @ geometry.pointmap[..., None])[..., 0] + pose[..., :3, 3]
    projected = (geometry.cameras.intrinsics[:, :, None, None] @ local[..., None])[..., 0]
    seen = projected[..., :2] / projected[..., 2:]
    rows, columns = torch.meshgrid(torch.arange(28.0), torch.arange(42.0), indexing="ij")
    expected = torch.stack([columns, rows], dim=-1).expand_as(seen)
    torch.testing.assert_close(seen, expected, rtol=1e-3, atol=1e-2)
    assert not torch.allclose(local[..., 2], geometry.depth, rtol=1e-2)


def test_later_views_may_be_given_in_any_order() -> None:
    backbone, given, order = network("worldmirror"), views(4), [0, 3, 1, 2]
    with torch.no_grad():
        one, other = backbone.encode(given), backbone.encode(given.select(order))
    same(one.geometry.depth[:, order], other.geometry.depth, rtol=1e-3, atol=1e-4)
    same(one.attributes.color[:, order], other.attributes.color, rtol=1e-3, atol=1e-4)


def test_the_camera_heads_divide_its_channels() -> None:
    with pytest.raises(ValueError, match="camera_heads is 5"):
        WorldMirror(**(EXAMPLE | {"camera_heads": 5}))
