"""What holds for the network whatever its weights."""

from pathlib import Path
from typing import Any

import pytest
import torch

from anystyle.testing.oracle import hashed
from anystyle.types import Tokens, Views
from anystyle_backbones.depth_anything import DepthAnything
from tests.support.backbone_cases import network, same, views

EXAMPLE = DepthAnything.example(Path())


@pytest.fixture(scope="module")
def backbone() -> DepthAnything:
    return network("depth_anything")


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

    def test_scenes_of_a_batch_choose_by_themselves(self, backbone: DepthAnything) -> None:
        both = views(4, scenes=2)
        with torch.no_grad():
            scenes = backbone.encode(both)
            for row in range(2):
                alone = backbone.encode(Views(both.images[row : row + 1]))
                assert scenes.stem.reference is not None and alone.stem.reference is not None
                assert scenes.stem.reference[row] == alone.stem.reference[0]
                same(scenes.attributes.map(lambda t, row=row: t[row : row + 1]), alone.attributes, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alternate_from": 0}, "give a block from 1 to depth - 1 = 7"),
        ({"alternate_from": 8}, "give a block from 1 to depth - 1 = 7"),
        ({"taps": (2, 5, 6, 7)}, "give four layers from 3 on"),
        ({"gaussian_features": 16}, "init=scratch needs 24"),
    ],
)
def test_options_that_contradict_each_other(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DepthAnything(**(EXAMPLE | options))
