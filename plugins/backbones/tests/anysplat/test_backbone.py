"""What holds for the network whatever its weights."""

from pathlib import Path

import pytest
import torch

from anystyle_backbones.anysplat import AnySplat
from tests.support.backbone_cases import network, same, views

EXAMPLE = AnySplat.example(Path())


def test_the_published_sites_are_the_tapped_ones() -> None:
    with torch.device("meta"):
        sites = AnySplat().sites
    assert [site.name for site in sites[:24]] == [f"aggregator/{layer}" for layer in range(24)]
    tapped = [site.name for site in sites if site.tapped]
    assert tapped[:5] == [f"aggregator/{layer}" for layer in (0, 4, 11, 17, 23)]
    assert {site.dim for site in sites[:24]} == {1024}
    tokens = [(f"head/tokens/{level}", 2048) for level in range(4)]
    assert [(site.name, site.dim) for site in sites[24:]] == [*tokens, ("head/direct", 128)]


def test_later_views_may_be_given_in_any_order() -> None:
    """The first view's camera token differs; all other views are treated alike."""
    backbone, given, order = network("anysplat"), views(4), [0, 3, 1, 2]
    with torch.no_grad():
        one, other = backbone.encode(given), backbone.encode(given.select(order))
    same(one.geometry.depth[:, order], other.geometry.depth, rtol=1e-3, atol=1e-4)
    same(one.attributes.color[:, order], other.attributes.color, rtol=1e-3, atol=1e-4)
    same(one.cameras.world_from_camera[:, order], other.cameras.world_from_camera, rtol=1e-3, atol=1e-4)


def test_the_camera_heads_divide_its_channels() -> None:
    with pytest.raises(ValueError, match="camera_heads is 5"):
        AnySplat(**(EXAMPLE | {"camera_heads": 5}))
