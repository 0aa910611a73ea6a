"""What a card is asked for: how many kernels there are, and that none of them waits for the host."""

from contextlib import nullcontext

import pytest
import torch

import anystyle
from anystyle.nn.attention import Attention, Block
from anystyle.nn.tokens import Rotary, grid_positions, rotary, rotate
from anystyle.pipeline import memory
from anystyle.types import StyleEmbedding
from anystyle_backbones.blocks import with_norms
from tests.support.backbone_cases import network, same, views
from tests.support.elsewhere import nothing_kept
from tests.support.kernels import Kernels

NARROW = """
dim=64 heads=4 camera_heads=4 depth_features=16 depth_channels=[16,16,16,16] depth_hidden=8 gaussian_features=16
gaussian_channels=[16,16,16,16] gaussian_hidden=8
"""


@torch.no_grad()
def test_a_block_is_few_kernels() -> None:
    """Four products, three norms, attention, GELU, two residuals, and three for the rotation."""
    block, tokens = Block(32, 2, mlp_ratio=4.0, layer_scale=0.1, qk_norm=True), torch.randn(2, 7, 32)
    (folded,) = with_norms([block], rotary(grid_positions((2, 3), 1), 16, base=100.0, like=tokens))
    with Kernels() as kernels:
        block(tokens, folded)
    assert kernels.count == 4 + 3 + 1 + 1 + 2 + 3


@torch.no_grad()
def test_queries_and_keys_are_normalised_each_by_its_own_norm() -> None:
    attention, tokens = Attention(32, 2, qk_norm=True), torch.randn(2, 14, 32)
    for norm in (attention.q_norm, attention.k_norm):
        for parameter in norm.parameters():
            parameter.normal_()
    angles = rotary(grid_positions((2, 3), 1), 16, base=100.0, like=tokens)
    q, k, v = attention.qkv(tokens).unflatten(-1, (3, 2, 16)).permute(2, 0, 3, 1, 4)
    twice = Rotary(angles.cos.repeat(2, 1), angles.sin.repeat(2, 1))
    q, k = rotate(attention.q_norm(q), twice), rotate(attention.k_norm(k), twice)
    mixed = torch.nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
    for given in (angles, *with_norms([attention], angles)):
        torch.testing.assert_close(attention(tokens, given), attention.proj(mixed))


@torch.no_grad()
def test_a_pass_of_the_published_depth_is_few_kernels() -> None:
    """At two views; 880 are those of 88 blocks without their rotations, 227 those of three decoders."""
    words = [f"weights.{part}=null" for part in ("backbone", "style_encoder", "branch")]
    stylizer = anystyle.load("anystyle_head", [*words, *(f"backbone.{word}" for word in NARROW.split())])
    vector = torch.nn.functional.normalize(torch.ones(1, stylizer.style_encoder.dim))
    photographs, style = views(2), StyleEmbedding(vector, vector)
    stylizer(photographs, style)  # keeps what depends on sizes alone
    with Kernels() as single:
        stylizer(photographs, style)
    scene = stylizer.encode(photographs)
    with Kernels() as further:
        stylizer.restyle(scene, style)
    assert single.count <= 1_532 and further.count <= 139


@torch.no_grad()
@pytest.mark.parametrize("name", ["anysplat", "depth_anything", "styl3r", "stylos"])
def test_memory_is_estimated_before_a_pass_and_after_it(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """What is kept by size has values though the estimate has none, and the estimate takes what is kept."""
    backbone, given = network(name), views(8, patch=network(name).patch_size)
    with nothing_kept():
        before = memory.encoding(backbone, given.size)
        first = backbone.encode(given)
        assert before is not None and memory.encoding(backbone, given.size) == pytest.approx(before, rel=0.1)
    same(backbone.encode(given), first)
    assert "not estimated" not in caplog.text


@torch.no_grad()
@pytest.mark.parametrize("name", ["anysplat", "depth_anything", "styl3r", "stylos"])
def test_nothing_of_a_network_comes_from_the_host(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())  # it does not know the meta device
    backbone = network(name)
    backbone, images = backbone.to("meta"), views(2, patch=backbone.patch_size).images.to("meta")
    with nothing_kept():
        for mode in (nullcontext(), Kernels("meta")):  # the first keeps what depends on sizes alone
            with mode:
                features = backbone.aggregator(backbone.embedder(images))
                backbone.geometry_head(features, images)
                backbone.gaussian_head(features, images)
