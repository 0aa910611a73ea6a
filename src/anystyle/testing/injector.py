"""What an injector promises: see :class:`anystyle.contracts.Injector`."""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.testing import asserts
from anystyle.testing.inputs import generator, noise
from anystyle.testing.subject import Subject
from anystyle.types import Site, Tokens
from anystyle.types.seeds import seeded
from anystyle.types.shapes import check_value

STYLE_DIM, DIM = 24, 64


def test_changes_nothing_at_initialisation(plugin: Subject[Injector]) -> None:
    """Before any training it returns the tokens bit for bit, for any number of channels, views and tokens."""
    for seed, dim in enumerate((DIM, DIM, 128)):
        injector = plugin.build(seed, dim=dim, style_dim=STYLE_DIM, site=Site("head/tokens", dim))
        for special, (rows, columns), number in ((0, (3, 5), 2), (5, (4, 4), 1)):
            tokens = _tokens(2, number, (rows, columns), special, dim)
            what = f"tokens after an untrained injector ({special} special tokens)"
            result = injector(tokens, _style(plugin, 2))
            check_value(result, Tokens, what, B=2, V=number, P=tokens.data.shape[2], C=dim)
            asserts.same(result.data, tokens.data, what)
            kept = (result.grid, result.special, result.data.dtype) == (tokens.grid, special, tokens.data.dtype)
            assert kept, f"{result.grid=}, {result.special=}, {result.data.dtype=}; return `tokens.with_patches(...)`"


def test_learns_everywhere_by_the_second_step(plugin: Subject[Injector]) -> None:
    """It has parameters; after one optimiser step each has a gradient that is finite and not all 0."""
    parameters = dict(_trained(plugin).named_parameters())
    assert parameters, "no parameters"
    for name, parameter in parameters.items():
        asserts.gradient(parameter.grad, f"`{name}` in the second step")


@torch.no_grad()
def test_style_matters_after_training(plugin: Subject[Injector]) -> None:
    """After training, two styles change the same tokens differently, and finitely; the tokens that came in stay."""
    tokens = _tokens(1, 2, (3, 5), 5)
    before = tokens.data.clone()
    one, other = (_trained(plugin)(tokens, _style(plugin, 1, seed)) for seed in (1, 2))
    asserts.finite(one, "tokens after training")
    differs = (one.data != other.data).any(-1)  # B V P
    patches = differs[..., tokens.special :]
    assert differs.any(), "the same tokens in two styles"
    assert patches.all() or not patches.any(), f"{int(patches.sum())} of {patches.numel()} patches differ in two styles"
    asserts.same(tokens.data, before, "the tokens that came in")


@torch.no_grad()
def test_styles_of_a_batch_stay_apart(plugin: Subject[Injector]) -> None:
    """Each row of a batch gets its own style: a batch gives what its rows give alone."""
    tokens, style = _tokens(3, 2, (3, 5), 5), _style(plugin, 3)
    together = _trained(plugin)(tokens, style).data
    for row in range(3):
        alone = _trained(plugin)(tokens.with_data(tokens.data[row : row + 1]), style[row : row + 1]).data
        asserts.close(together[row : row + 1], alone, f"row {row} of a batch against the same row alone")


@torch.no_grad()
def test_views_have_no_order(plugin: Subject[Injector]) -> None:
    """Views in another order give the same tokens in that order."""
    tokens, style, order = _tokens(2, 3, (3, 5), 5), _style(plugin, 2), [2, 0, 1]
    reordered = _trained(plugin)(tokens.with_data(tokens.data[:, order]), style).data
    asserts.close(reordered, _trained(plugin)(tokens, style).data[:, order], "tokens of views in another order")


def test_gradients_reach_tokens_and_style(plugin: Subject[Injector]) -> None:
    """After training, it is differentiable in the tokens and in the style."""
    tokens, style = _tokens(1, 2, (3, 5), 5), _style(plugin, 1).requires_grad_()
    data = tokens.data.clone().requires_grad_()
    result = _trained(plugin)(tokens.with_data(data), style).data
    (result * noise(result)).sum().backward()
    asserts.gradient(data.grad, "the tokens")
    asserts.gradient(style.grad, "the style")


def _tokens(batch: int, number: int, grid: tuple[int, int], special: int, dim: int = DIM) -> Tokens:
    count = special + grid[0] * grid[1]
    return Tokens(torch.randn(batch, number, count, dim, generator=generator(count)), grid=grid, special=special)


def _style(plugin: Subject[Injector], batch: int, seed: int = 0) -> Float[Tensor, "B *tokens D"]:
    shape = (batch, 7, STYLE_DIM) if plugin.cls.reads_tokens else (batch, STYLE_DIM)
    return nn.functional.normalize(torch.randn(shape, generator=generator(100 + seed)), dim=-1)


@cache
@torch.enable_grad()
def _trained(plugin: Subject[Injector]) -> Injector:
    """After a step towards random tokens, so that no direction of the error is 0; with the gradients of the second."""
    injector = plugin.build(dim=DIM, style_dim=STYLE_DIM, site=Site("head/tokens", DIM))
    parameters = list(injector.parameters())
    if not parameters:
        return injector
    optimizer = torch.optim.Adam(parameters, lr=1e-2)
    tokens, style = _tokens(4, 2, (3, 5), 5), _style(plugin, 4)
    with seeded(0):
        for step in range(2):
            injector.zero_grad()
            (injector(tokens, style).data - noise(tokens.data, 9)).square().mean().backward()
            if step == 0:
                optimizer.step()
    return injector
