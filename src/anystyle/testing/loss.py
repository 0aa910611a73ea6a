"""What a loss promises: see :class:`anystyle.contracts.Loss`."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import (
    conform_tensor,
    expect_close,
    expect_finite,
    expect_same,
    expect_untouched,
    tensors_of,
)
from anystyle.testing.inputs import images, stylization
from anystyle.testing.subject import Subject, seeded
from anystyle.types import Stylization

Plugin = Subject[Loss]


def weight_is_a_number(plugin: Plugin) -> None:
    """The constructor sets ``weight``, which the framework multiplies by."""
    weight = getattr(plugin.instance, "weight", None)
    expect(
        isinstance(weight, (int, float)) and not isinstance(weight, bool),
        given=f"weight={weight!r}",
        expected="a number",
        change="take `weight: float = 1.0` in the constructor and set `self.weight`",
    )


def value_is_one_finite_number(plugin: Plugin) -> None:
    """It gives one finite number for any number of scenes and views, also where they are not square."""
    for batch, number, size in ((1, 2, (80, 80)), (2, 3, (64, 80)), (1, 1, (96, 64))):
        what = f"{batch} scene(s), {number} view(s) of {size[0]}x{size[1]} pixels"
        with attempt(f"the loss of {what}", change="make it work for any number of scenes, views and pixels"):
            value = _value(plugin, stylization(batch, number, size))
        conform_tensor(value, Float[Tensor, ""], f"the loss of {what}")
        expect(
            value.dtype == torch.float32,
            given=f"the loss of {what} is {str(value.dtype).removeprefix('torch.')}",
            expected="float32, as the renders are",
            change="look for `.double()`, or for a number that numpy made",
        )
        expect_finite(value, f"the loss of {what}")


def styles_may_lack_a_part(plugin: Plugin) -> None:
    """A style of an image alone, or of a text alone, gives a finite number too."""
    for image, text in ((True, False), (False, True)):
        what = "a style of an image alone" if image else "a style of a text alone"
        change = "add nothing for styles that lack what it needs: `0.0 * result.renders.color.sum()`"
        with attempt(f"the loss of {what}", change=change):
            value = _value(plugin, stylization(image=image, text=text))
        conform_tensor(value, Float[Tensor, ""], f"the loss of {what}")
        expect_finite(value, f"the loss of {what}")


def absent_images_are_not_read(plugin: Plugin) -> None:
    """Where ``style.has_image`` is false, what stands in its place changes nothing."""
    result = stylization(2, 2)
    assert result.style.image is not None
    has_image = torch.tensor([True, False])
    other = result.style.image.clone()
    other[1] = images(1, (48, 40), seed=60)[0]
    values = [
        _value(plugin, replace(result, style=replace(result.style, image=image, has_image=has_image)))
        for image in (result.style.image, other)
    ]
    expect_close(
        values[1],
        values[0],
        what="the loss with other pixels where a style has no image",
        change="leave out rows where `style.has_image` is false",
        tolerance=1e-5,
    )


def value_is_reproducible(plugin: Plugin) -> None:
    """After the same seed the same stylization gives the same number, and is left as it was."""
    result = stylization(1, 2)
    kept = result.map(lambda tensor: tensor.detach().clone())
    once, twice = _value(plugin, result), _value(plugin, result)
    change = "draw from torch's global generator, or from one that is seeded in each call"
    expect_same(twice, once, what="the same loss again", change=change)
    expect_untouched(result, kept, "the stylization after the loss was computed")


def something_learns_from_it(plugin: Plugin) -> None:
    """It has a finite gradient in the renders, the Gaussians or what the backbone predicted."""
    result = stylization(1, 2)
    scene = result.scene.map(lambda t: t.detach().clone().requires_grad_(t.is_floating_point()))
    result = replace(result, scene=scene)
    value = _value(plugin, result)
    change = "compute it with torch from `result.renders`, `result.gaussians` or `result.scene`, detaching nothing"
    with attempt("the backward pass", change=change):
        value.backward()
    leaves = {name: leaf for name, leaf in tensors_of(result).items() if leaf.grad is not None}
    expect(
        any(bool(leaf.grad.any()) for leaf in leaves.values() if leaf.grad is not None),
        given="a gradient of 0 in everything",
        change=change,
    )
    for name, leaf in leaves.items():
        expect_finite(leaf.grad, f"the gradient in `{name}`")


def _value(plugin: Plugin, result: Stylization) -> Tensor:
    with seeded(0):
        return plugin.instance.eval()(result)


CHECKS: tuple[Check, ...] = (
    Check(weight_is_a_number),
    Check(value_is_one_finite_number, needed=True),
    Check(styles_may_lack_a_part),
    Check(absent_images_are_not_read),
    Check(value_is_reproducible),
    Check(something_learns_from_it),
)
