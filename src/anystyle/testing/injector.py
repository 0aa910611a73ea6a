"""What an injector promises: see :class:`anystyle.contracts.Injector`."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import (
    conform,
    conform_tensor,
    expect_close,
    expect_finite,
    expect_gradient,
    expect_same,
    expect_untouched,
)
from anystyle.testing.inputs import generator
from anystyle.testing.subject import Subject, seeded
from anystyle.types import Tokens

Plugin = Subject[Injector]

STYLE_DIM = 24
DIMS = (64, 128)


def fits_every_site(plugin: Plugin) -> None:
    """It can be built for any number of channels, and keeps the shape, the grid and the kind of tokens."""
    for dim in DIMS:
        with attempt(f"building it for {dim} channels", change="take `dim` and `style_dim` in the constructor"):
            injector = _make(plugin, dim)
        for batch, number, grid, special in ((1, 2, (3, 5), 0), (2, 1, (4, 4), 5), (1, 1, (1, 1), 1)):
            tokens = _tokens(batch, number, grid, special, dim)
            what = f"{batch} scene(s), {number} view(s), {special} special tokens and a grid of {grid[0]}x{grid[1]}"
            with attempt(what, change="make it work for any number of scenes, views and tokens"):
                result = injector(tokens, _style(batch))
            sizes = {"B": batch, "V": number, "P": tokens.data.shape[2], "C": dim}
            conform(result, Tokens, f"the injector on {what}", **sizes)
            kept = (result.grid, result.special) == (tokens.grid, tokens.special)
            kept &= result.reference is tokens.reference
            expect(
                kept and result.data.dtype == tokens.data.dtype,
                given=f"other tokens: {result.grid=}, {result.special=}, {result.data.dtype=}, reference kept: {kept}",
                change="return `tokens.with_patches(...)` or `tokens.with_data(...)`",
            )


def changes_nothing_at_birth(plugin: Plugin) -> None:
    """Before any training it returns the tokens bit for bit, whatever the style."""
    for seed in range(3):
        injector = _make(plugin, DIMS[0], seed=seed)
        for special in (0, 5):
            tokens = _tokens(2, 3, (3, 5), special, DIMS[0])
            expect_same(
                injector(tokens, _style(2, seed=seed)).data,
                tokens.data,
                what=f"tokens after an untrained injector (seed {seed}, {special} special tokens)",
                change="set the last layer's weight and bias to 0 and add its output, or multiply by 1 plus it",
            )


def learns_everywhere_by_the_second_step(plugin: Plugin) -> None:
    """After one step of an optimiser every parameter has a gradient that is finite and not all 0."""
    injector = _make(plugin, DIMS[0])
    names = dict(injector.named_parameters())
    expect(
        len(names) > 0,
        given="an injector without parameters",
        expected="something to train, or it stays the identity for ever",
        change="register layers as submodules in the constructor",
    )
    _train(injector, steps=2)
    change = "make only the last factor of a product zero at birth, and leave out layers that are not used"
    for name, parameter in names.items():
        expect_gradient(parameter.grad, f"{name}, in the second step,", change=change)


def style_matters_after_training(plugin: Plugin) -> None:
    """Once trained a little, two styles change the same tokens differently, and finitely."""
    injector = _trained(plugin)
    tokens = _tokens(1, 2, (3, 5), 5, DIMS[0])
    with torch.no_grad():
        one, other = injector(tokens, _style(1, seed=1)), injector(tokens, _style(1, seed=2))
    expect_finite(one, "tokens after training")
    expect(
        not torch.equal(one.data, other.data) and not torch.equal(one.data, tokens.data),
        given="tokens that do not depend on the style",
        change="use `style` in `forward`",
    )


def styles_of_a_batch_stay_apart(plugin: Plugin) -> None:
    """Each row of a batch gets its own style: a batch gives what its rows give alone."""
    injector = _trained(plugin)
    tokens, style = _tokens(3, 2, (3, 5), 5, DIMS[0]), _style(3)
    with torch.no_grad():
        together = injector(tokens, style)
        for row in range(3):
            alone = injector(tokens.with_data(tokens.data[row : row + 1]), style[row : row + 1])
            expect_close(
                together.data[row : row + 1],
                alone.data,
                what=f"row {row} of a batch against the same row alone",
                change="broadcast the style over views and tokens: `style[:, None, None]`",
            )


def views_have_no_order(plugin: Plugin) -> None:
    """Views in another order give the same tokens in that order."""
    injector = _trained(plugin)
    tokens, style = _tokens(2, 3, (3, 5), 5, DIMS[0]), _style(2)
    order = [2, 0, 1]
    with torch.no_grad():
        expect_close(
            injector(tokens.with_data(tokens.data[:, order]), style).data,
            injector(tokens, style).data[:, order],
            what="tokens of views in another order",
            change="give no view a special part: no parameter, mask or position by its number",
        )


def tokens_are_not_overwritten(plugin: Plugin) -> None:
    """The tokens that come in are left as they were; a scene's are shared by all its styles."""
    injector = _trained(plugin)
    tokens = _tokens(1, 2, (3, 5), 5, DIMS[0])
    kept = tokens.data.clone()
    with torch.no_grad():
        injector(tokens, _style(1))
    expect_untouched(tokens.data, kept, "the tokens that were passed in")


def gradients_reach_tokens_and_style(plugin: Plugin) -> None:
    """It is differentiable in the tokens at birth, and in the style once trained."""
    injector = _trained(plugin)
    tokens = _tokens(1, 2, (3, 5), 5, DIMS[0])
    data, style = tokens.data.clone().requires_grad_(), _style(1).requires_grad_()
    result = injector(tokens.with_data(data), style).data
    conform_tensor(result, Float[Tensor, "B V P C"], "the injector", B=1, V=2)
    (result * torch.randn(result.shape, generator=generator(5))).sum().backward()
    for name, leaf in (("the tokens", data), ("the style", style)):
        expect_gradient(leaf.grad, name, change="do not detach, and stay within torch")


def _make(plugin: Plugin, dim: int, seed: int = 0) -> Injector:
    return plugin.build(seed=seed, dim=dim, style_dim=STYLE_DIM)


def _tokens(batch: int, number: int, grid: tuple[int, int], special: int, dim: int) -> Tokens:
    count = special + grid[0] * grid[1]
    data = torch.randn(batch, number, count, dim, generator=generator(count))
    return Tokens(data, grid=grid, special=special)


def _style(batch: int, seed: int = 0) -> Float[Tensor, "B D"]:
    return nn.functional.normalize(torch.randn(batch, STYLE_DIM, generator=generator(100 + seed)), dim=-1)


def _trained(plugin: Plugin) -> Injector:
    """After three steps, made once: no check changes it."""

    def make() -> Injector:
        injector = _make(plugin, DIMS[0])
        _train(injector, steps=3)
        return injector

    return plugin.once("trained", make)


def _train(injector: Injector, steps: int) -> None:
    # Towards random tokens, so that no direction of the error is 0 by chance; gradients of the last step stay.
    optimizer = torch.optim.Adam(injector.parameters(), lr=1e-2)
    tokens, style = _tokens(4, 2, (3, 5), 5, DIMS[0]), _style(4)
    target = torch.randn(tokens.data.shape, generator=generator(9))
    with seeded(0):
        for step in range(steps):
            optimizer.zero_grad()
            loss = (injector(tokens, style).data - target).square().mean()
            loss.backward()
            if step < steps - 1:
                optimizer.step()


CHECKS: tuple[Check, ...] = (
    Check(fits_every_site, needed=True),
    Check(changes_nothing_at_birth),
    Check(learns_everywhere_by_the_second_step),
    Check(style_matters_after_training),
    Check(styles_of_a_batch_stay_apart),
    Check(views_have_no_order),
    Check(tokens_are_not_overwritten),
    Check(gradients_reach_tokens_and_style),
)
