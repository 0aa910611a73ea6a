"""Where style may enter the network, and which view is the reference."""

import torch

from anystyle.testing.oracle import hashed
from anystyle.types import Tokens, Views
from anystyle_backbones.depth_anything import DepthAnything
from tests.support.backbone_cases import network, same, views


def test_the_largest_network_s_sites() -> None:
    with torch.device("meta"):
        sites = DepthAnything().sites
    assert [site.name for site in sites[:27]] == [f"aggregator/{layer}" for layer in range(13, 40)]
    tapped = [site.name for site in sites[:27] if site.tapped]
    assert tapped == [f"aggregator/{layer}" for layer in (13, 18, 26, 32, 38)]
    assert {site.dim for site in sites[:27]} == {1536}
    tokens = [(f"head/tokens/{level}", 3072, True) for level in range(4)]
    assert [(site.name, site.dim, site.tapped) for site in sites[27:]] == [*tokens, ("head/direct", 128, True)]


def test_a_style_at_a_tapped_site_is_in_both_halves_of_what_heads_read() -> None:
    backbone = network("depth_anything")
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


@torch.no_grad()
def test_scenes_of_a_batch_choose_their_reference_by_themselves() -> None:
    backbone, both = network("depth_anything"), views(4, scenes=2)
    scenes = backbone.encode(both)
    for row in range(2):
        alone = backbone.encode(Views(both.images[row : row + 1]))
        assert scenes.stem.reference is not None and alone.stem.reference is not None
        assert scenes.stem.reference[row] == alone.stem.reference[0]
        same(scenes.attributes.row(row), alone.attributes, rtol=1e-3, atol=1e-4)
