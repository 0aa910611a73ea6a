"""The injector at the colours of a scene, and the networks in 2D."""

import pytest
import torch
import torch.nn.functional as F

from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.testing import assert_contract
from anystyle.testing.inputs import images
from anystyle.types import Tokens
from anystyle_magenta import MagentaEncoder, MagentaInjector, stylize_images
from anystyle_magenta.injector import MARKS, USUAL, stroke_scales, working_shape
from anystyle_magenta.networks import conditional_instance_norm

GRID = (24, 32)


@pytest.fixture(scope="module")
def style():
    with torch.no_grad():
        return MagentaEncoder().embed_images(images(2, (48, 64), seed=3))


def _tokens(batch: int = 1, num_views: int = 3) -> Tokens:
    rows = torch.stack([images(num_views, GRID, seed=seed) for seed in range(batch)])
    return Tokens(constant_from_rgb(rows.flatten(-2).mT), grid=GRID)


def _pictures(tokens: Tokens) -> torch.Tensor:
    return rgb_from_constant(tokens.data).mT.unflatten(-1, tokens.grid)


def test_both_keep_their_contracts_with_published_weights():
    assert_contract("style_encoder", MagentaEncoder, pretrained=True)


@torch.no_grad()
def test_an_open_gate_gives_the_stylized_views(style):
    tokens = _tokens(2)
    injector = MagentaInjector(dim=3, style_dim=100, gate=1.0, working_size=64)
    expected = stylize_images(injector.network, _pictures(tokens), style, working_size=64, joint=True)
    torch.testing.assert_close(_pictures(injector(tokens, style)), expected, rtol=0, atol=1e-6)
    half = MagentaInjector(dim=3, style_dim=100, gate=0.5, working_size=64)(tokens, style)
    torch.testing.assert_close(_pictures(half), (_pictures(tokens) + expected) / 2, rtol=0, atol=1e-6)


def test_large_views_are_painted_coarse_to_fine_and_strokes_have_a_scale(style):
    injector = MagentaInjector(dim=3, style_dim=100, gate=1.0, working_size=64)
    assert injector.sizes((64, 80)) == [64] == injector.sizes((40, 60)) and injector.sizes((378, 504)) == [64, 128, 256]
    assert injector.at_scale(2.0).sizes((64, 80)) == [32, 48]
    assert injector.at_scale(0.5).sizes((64, 80)) == [128] == injector.at_scale(0.1).sizes((64, 80))
    assert injector.at_scale(2.0).at_scale(0.5).sizes((64, 80)) == [64]
    flat = MagentaInjector(dim=3, style_dim=100, gate=1.0, working_size=64, coarse_to_fine=False)
    assert flat.sizes((378, 504)) == [64]
    large = injector.at_scale(2.0)
    assert large.network is injector.network and injector.scale == 1
    tokens, vector = _tokens(), style[:1]
    with torch.no_grad():
        coarse = stylize_images(injector.network, _pictures(tokens), vector, working_size=32, joint=True)
        for size in large.sizes(GRID)[1:]:
            coarse = stylize_images(injector.network, coarse, vector, working_size=size, joint=True)
        torch.testing.assert_close(_pictures(large(tokens, vector)), coarse, rtol=0, atol=1e-5)


@torch.no_grad()
def test_strokes_are_as_broad_as_each_style_asks_for(style):
    injector = MagentaInjector(dim=3, style_dim=100, gate=1.0, working_size=32, own_strokes=True)
    tokens, chosen = _tokens(2), style.clone()
    chosen[:, list(MARKS)] = torch.tensor([[-1.0], [1.0]])
    assert stroke_scales(chosen) == pytest.approx([0.5**0.5, 2**0.5])
    for row, size in enumerate((round(32 * 2**0.5), round(32 / 2**0.5))):
        given = _pictures(tokens)[row : row + 1], chosen[row : row + 1]
        expected = stylize_images(injector.network, *given, working_size=size, joint=True)
        torch.testing.assert_close(_pictures(injector(tokens, chosen))[row], expected[0], rtol=0, atol=1e-5)
    chosen[:, list(MARKS)] = USUAL / sum(MARKS.values())
    assert stroke_scales(chosen) == pytest.approx([1.0, 1.0], abs=1e-5)


@torch.no_grad()
def test_special_tokens_stay(style):
    tokens = _tokens()
    special = torch.randn(1, 3, 2, 3, generator=torch.Generator().manual_seed(0))
    longer = Tokens(torch.cat([special, tokens.data], dim=2), grid=GRID, special=2)
    injector = MagentaInjector(dim=3, style_dim=100, gate=1.0, working_size=32)
    result = injector(longer, style[:1])
    assert torch.equal(result.data[:, :, :2], special)
    torch.testing.assert_close(result.patches, injector(tokens, style[:1]).data, rtol=0, atol=1e-4)


def test_the_normalisation_is_instance_norm_of_the_joined_views():
    source = torch.Generator().manual_seed(0)
    maps = torch.randn(2, 3, 4, 5, 6, generator=source, dtype=torch.float64) * 3 + 1
    scale, shift = (torch.randn(2, 4, generator=source, dtype=torch.float64) for _ in range(2))
    joined = maps.transpose(1, 2).flatten(2)  # B C (V h w): instance normalisation of one long signal
    expected = F.instance_norm(joined) * scale[..., None] + shift[..., None]
    result = torch.cat(conditional_instance_norm(list(maps.split(2, dim=1)), scale, shift), dim=1)
    torch.testing.assert_close(result.transpose(1, 2).flatten(2), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("size", "working_size", "expected"),
    [
        ((112, 154), 224, (224, 308)),
        ((720, 405), 224, (400, 224)),
        ((3, 900), None, (8, 900)),
        ((30, 31), None, (32, 32)),
    ],
)
def test_working_sizes_keep_the_aspect(size, working_size, expected):
    assert working_shape(size, working_size) == expected


def test_what_published_weights_cannot_take_is_refused():
    for dim, style_dim in ((12, 100), (3, 128)):
        with pytest.raises(ValueError, match=r"stylizes colours, 3 channels, by the 100 numbers.*placement=color"):
            MagentaInjector(dim=dim, style_dim=style_dim)


@torch.no_grad()
def test_the_middle_of_a_picture_is_what_counts():
    encoder = MagentaEncoder()
    square = images(1, (256, 256))
    wide = torch.cat([torch.zeros(1, 3, 256, 40), square, torch.ones(1, 3, 256, 40)], dim=-1)
    torch.testing.assert_close(encoder.embed_images(wide), encoder.embed_images(square), rtol=0, atol=1e-6)
