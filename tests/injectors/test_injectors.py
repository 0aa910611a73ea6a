"""What each injector computes, against its paper's formula written out; what all share is in their contract."""

import math

import numpy as np
import pytest
import torch
from scipy.special import expit, softmax

from anystyle.contracts import Injector
from anystyle.injectors.ada_ln import AdaLN
from anystyle.injectors.cross_attention import CrossAttention, TokenAttention
from anystyle.injectors.film import FiLM
from anystyle.injectors.lora import LoRA
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.registry.catalog import catalog
from anystyle.testing import assert_contract
from anystyle.types import Tokens

DIM, STYLE = 12, 5
ALL = [AdaLN, CrossAttention, FiLM, LoRA, ZeroConv]


def _tokens(batch=2, views=3, special=2, dim=DIM):
    generator = torch.Generator().manual_seed(0)
    return Tokens(torch.randn(batch, views, special + 6, dim, generator=generator), grid=(2, 3), special=special)


def _style(batch=2):
    return torch.randn(batch, STYLE, generator=torch.Generator().manual_seed(1))


def _trained(cls, **options) -> Injector:
    """An injector whose every weight is a random number."""
    injector = cls(dim=DIM, style_dim=STYLE, **options)
    generator = torch.Generator().manual_seed(2)
    with torch.no_grad():
        for parameter in injector.parameters():
            parameter.copy_(0.5 * torch.randn(parameter.shape, generator=generator))
    return injector.double()


def _expected(cls, injector, tokens, style):
    """The formula of each paper in NumPy, token by token."""
    weights = {name: value.detach().numpy() for name, value in injector.named_parameters()}

    def linear(name, value):
        return value @ weights[f"{name}.weight"].T + weights.get(f"{name}.bias", 0.0)

    def normalised(value, eps):
        centred = value - value.mean(-1, keepdims=True)
        return centred / np.sqrt((centred**2).mean(-1, keepdims=True) + eps)

    def film(x, z):
        hidden = np.maximum(linear("fc.2", np.maximum(linear("fc.0", z), 0)), 0)
        scale, shift = np.split(linear("modulation", hidden), 2)
        return (1 + scale) * x + shift

    def ada_ln(x, z):
        hidden = linear("fc.0", z)
        shift, scale, gate = np.split(linear("modulation", hidden * expit(hidden)), 3)
        return x + gate * (normalised(x, 1e-6) * (1 + scale) + shift)

    def lora(x, z):
        strength = np.diag(linear("strength", z))
        return x + injector.factor * weights["up.weight"] @ strength @ weights["down.weight"] @ x

    def cross_attention(x, z):
        coded = normalised(linear("style_tokens", z).reshape(injector.num_tokens, -1), 1e-5)
        coded = coded * weights["style_norm.weight"] + weights["style_norm.bias"]
        query = linear("query", normalised(x, 1e-5) * weights["norm.weight"] + weights["norm.bias"])
        keys, values = linear("key", coded), linear("value", coded)
        attended = []
        for head in np.split(np.arange(query.size), injector.heads):
            attended.append(softmax(keys[:, head] @ query[head] / math.sqrt(head.size)) @ values[:, head])
        return x + linear("zero_proj", np.concatenate(attended))

    formula = {FiLM: film, AdaLN: ada_ln, LoRA: lora, CrossAttention: cross_attention}[cls]
    return np.array(
        [
            [[formula(token, z) for token in view] for view in scene]
            for scene, z in zip(tokens.numpy(), style.numpy(), strict=True)
        ]
    )


@pytest.mark.parametrize("special", [False, True])
@pytest.mark.parametrize(
    ("cls", "options"),
    [
        (FiLM, {}),
        (AdaLN, {"hidden": 7}),
        (LoRA, {"rank": 3, "alpha": 2.0}),
        (CrossAttention, {"num_tokens": 4, "heads": 2, "head_dim": 3}),
    ],
)
def test_formula(cls, options, special):
    injector = _trained(cls, special_tokens=special, **options)
    tokens, style = _tokens().to(torch.float64), _style().double()
    given = injector(tokens, style).data.detach().numpy()
    expected = _expected(cls, injector, tokens.data, style)
    start = 0 if special else tokens.special
    np.testing.assert_array_equal(given[:, :, :start], tokens.data.numpy()[:, :, :start])
    np.testing.assert_allclose(given[:, :, start:], expected[:, :, start:], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("cls", ALL)
def test_gain_is_that_of_the_embedding(cls):
    plain, loud = _trained(cls), _trained(cls, gain=3.0)
    tokens, style = _tokens().to(torch.float64), _style().double()
    torch.testing.assert_close(loud(tokens, style).data, plain(tokens, 3 * style).data, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
@pytest.mark.parametrize("cls", ALL)
def test_identity_at_birth_in_every_precision(cls, dtype):
    injector = cls(dim=DIM, style_dim=STYLE).to(dtype)
    tokens = _tokens().to(dtype)
    tokens = tokens.with_data(tokens.data * torch.logspace(-4, 2, DIM, dtype=torch.float64).to(dtype))
    result = injector(tokens, 10 * _style().to(dtype))
    assert result.data.dtype == dtype and torch.equal(result.data, tokens.data)


def test_token_attention_is_softmax_over_the_style_tokens():
    injector = _trained(TokenAttention, heads=2, head_dim=3)
    tokens, style = _tokens().to(torch.float64), torch.randn(2, 7, STYLE, dtype=torch.float64)
    given = injector(tokens, style).patches
    for scene, coded in enumerate(injector.style_norm(injector.style_tokens(style))):
        query, keys = injector.query(injector.norm(tokens.patches[scene])), injector.key(coded)
        values = injector.value(coded)
        heads = [
            (query[..., part] @ keys[:, part].T / math.sqrt(3)).softmax(-1) @ values[:, part]
            for part in (slice(0, 3), slice(3, 6))
        ]
        expected = tokens.patches[scene] + injector.zero_proj(torch.cat(heads, dim=-1))
        torch.testing.assert_close(given[scene], expected, rtol=1e-12, atol=1e-12)


def test_in_a_stylizer_the_views_see_each_other():
    tokens = _tokens().to(torch.float64)
    other = tokens.with_data(torch.cat([tokens.data[:, :2], tokens.data[:, 2:].flip(-1)], dim=1))
    style = torch.randn(2, 7, STYLE, dtype=torch.float64)
    alone, together = (_trained(TokenAttention, heads=2, head_dim=3, stylizer=on) for on in (False, True))
    assert torch.equal(alone(tokens, style).data[:, :2], alone(other, style).data[:, :2])
    assert not torch.allclose(together(tokens, style).data[:, :2], together(other, style).data[:, :2])


def test_low_rank_update_is_one_of_the_weights_that_read_the_tokens():
    injector = _trained(LoRA, rank=3)
    tokens, style = _tokens(batch=1).to(torch.float64), _style(1).double()
    layer = torch.nn.Linear(DIM, 9, dtype=torch.float64)
    strength = torch.diag(injector.strength(style[0]))
    update = layer.weight @ (injector.factor * injector.up.weight @ strength @ injector.down.weight)
    updated = torch.nn.functional.linear(tokens.patches, layer.weight + update, layer.bias)
    torch.testing.assert_close(layer(injector(tokens, style).patches), updated, rtol=1e-12, atol=1e-12)
    assert torch.linalg.matrix_rank(update) == 3


def test_attention_does_different_things_to_different_tokens_and_a_shift_does_not():
    tokens, style = _tokens().to(torch.float64), _style().double()
    for cls, varies in ((CrossAttention, True), (ZeroConv, False)):
        added = _trained(cls)(tokens, style).patches - tokens.patches
        assert (bool((added.std(dim=(1, 2)) > 1e-3).any())) is varies


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("film", {"hidden": 8, "special_tokens": True}),
        ("ada_ln", {"hidden": 8, "gain": 11.3}),
        ("cross_attention", {"num_tokens": 2, "heads": 1, "special_tokens": True}),
        ("lora", {"rank": 1, "special_tokens": True}),
        ("lora", {"rank": 500}),
    ],
)
def test_contract_with_other_options(name, options):
    cls = catalog().find("injector", name).load()

    class Chosen(cls):
        __doc__ = cls.__doc__

        @classmethod
        def example(cls, folder):
            return options

    assert_contract("injector", Chosen)
