"""What holds for the network whatever its weights."""

from pathlib import Path

import pytest
import torch

from anystyle_backbones.anysplat import AnySplat
from tests.support.backbone_cases import network, same, views

EXAMPLE = AnySplat.example(Path())


@pytest.fixture(scope="module")
def backbone() -> AnySplat:
    return network("anysplat")


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


def test_the_camera_heads_divide_its_channels() -> None:
    with pytest.raises(ValueError, match="camera_heads is 5"):
        AnySplat(**(EXAMPLE | {"camera_heads": 5}))
