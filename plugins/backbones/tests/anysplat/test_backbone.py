"""Where style may enter the published network."""

import torch

from anystyle_backbones.anysplat import AnySplat


def test_the_published_sites_are_the_tapped_ones() -> None:
    with torch.device("meta"):
        sites = AnySplat().sites
    assert [site.name for site in sites[:24]] == [f"aggregator/{layer}" for layer in range(24)]
    tapped = [site.name for site in sites if site.tapped]
    assert tapped[:5] == [f"aggregator/{layer}" for layer in (0, 4, 11, 17, 23)]
    assert {site.dim for site in sites[:24]} == {1024}
    tokens = [(f"head/tokens/{level}", 2048) for level in range(4)]
    assert [(site.name, site.dim) for site in sites[24:]] == [*tokens, ("head/direct", 128)]
