"""What a card is asked for: how many kernels there are, and that none of them waits for the host."""

from contextlib import nullcontext

import pytest
import torch

from anystyle.nn.attention import Block
from anystyle.nn.tokens import grid_positions, rotary
from tests.support.backbone_cases import network, views
from tests.support.elsewhere import nothing_kept
from tests.support.kernels import Kernels


@torch.no_grad()
def test_a_block_is_few_kernels() -> None:
    """Four products, four norms, attention, GELU, two residuals, and three for each rotation."""
    block, tokens = Block(32, 2, mlp_ratio=4.0, layer_scale=0.1, qk_norm=True), torch.randn(2, 7, 32)
    angles = rotary(grid_positions((2, 3), 1), 16, base=100.0, like=tokens)
    block(tokens, angles)
    with Kernels() as kernels:
        block(tokens, angles)
    assert kernels.count == 4 + 4 + 1 + 1 + 2 + 2 * 3


@torch.no_grad()
@pytest.mark.parametrize("name", ["anysplat", "depth_anything", "styl3r", "stylos"])
def test_nothing_of_a_network_comes_from_the_host(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())  # it does not know the meta device
    backbone = network(name)
    given = views(2, patch=backbone.patch_size)
    backbone, images = backbone.to("meta"), given.images.to("meta")
    with nothing_kept():
        for mode in (nullcontext(), Kernels("meta")):  # the first keeps what depends on sizes alone
            with mode:
                features = backbone.aggregator(backbone.embedder(images))
                backbone.geometry_head(features, images)
                backbone.gaussian_head(features, images)
