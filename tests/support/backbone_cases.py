"""Small networks of the repository's backbones with random weights, and what they are shown."""

from pathlib import Path
from typing import Any

import torch

from anystyle.branch import COLOR, StyleBranch, sites_of
from anystyle.contracts import Backbone
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.placements import AggregatorPlacement, Color, Full, Head
from anystyle.registry.catalog import catalog
from anystyle.testing.oracle import hashed, smooth_image
from anystyle.types import Scene, StyleEmbedding, Views

PLACEMENTS = {"head": Head(), "aggregator": AggregatorPlacement(), "full": Full(), "color": Color()}


def network(name: str, **options: Any) -> Backbone:
    plugin = catalog().find("backbone", name).load()
    torch.manual_seed(0)
    backbone = plugin(**(plugin.example(Path()) | options))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in backbone.parameters():
            if options.get("init") != "scratch":
                parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    return backbone.eval()


def views(count: int, scenes: int = 1, size: tuple[int, int] = (28, 42)) -> Views:
    return Views(smooth_image(count, (scenes, count, 3, *size)))


@torch.no_grad()
def check_placement(backbone: Backbone, scene: Scene, name: str, least: float) -> None:
    """Style changes nothing at initialisation, bit for bit; then harmonics by ``least`` or more, and no point."""
    vector = hashed(5, (1, 512), -1, 1)
    sites = PLACEMENTS[name].select(sites_of(backbone))
    branch = StyleBranch(
        backbone, sites=sites, make_injector=lambda site: ZeroConv(dim=site.dim, style_dim=512, hidden=8)
    )
    styled = branch(scene, StyleEmbedding(vector, vector))
    for attribute in ("opacity", "scale", "rotation", "color", "confidence"):
        assert torch.equal(getattr(styled, attribute), getattr(scene.attributes, attribute)), attribute
    for index, parameter in enumerate(branch.injectors.parameters()):
        parameter.copy_(hashed(index, parameter.shape, -0.3, 0.3))
    changed = branch(scene, StyleEmbedding(vector, vector))
    plain, other = (
        backbone.adapter(scene.attributes.with_(each, ("color",)), scene.geometry, scene.clusters)
        for each in (styled, changed)
    )
    assert (name == "color") == ({site.name for site in sites} == {COLOR})
    assert torch.equal(plain.means, other.means)
    assert (plain.harmonics - other.harmonics).abs().max() > least


def same(left: Any, right: Any, **tolerance: float) -> None:
    for one, other in zip(torch.utils._pytree.tree_leaves(left), torch.utils._pytree.tree_leaves(right), strict=True):
        if isinstance(one, torch.Tensor):
            torch.testing.assert_close(one, other, **tolerance)
