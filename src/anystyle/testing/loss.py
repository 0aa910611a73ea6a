"""What a loss promises: see :class:`anystyle.contracts.Loss`."""

import copy
from dataclasses import replace
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.testing import asserts
from anystyle.testing.inputs import images, style_encoder, stylization
from anystyle.testing.subject import Subject
from anystyle.types import Stylization
from anystyle.types.seeds import seeded
from anystyle.types.shapes import check_tensor


def test_value_is_one_finite_number(plugin: Subject[Loss]) -> None:
    """It has a ``weight``, and gives a finite number for any scenes, and for styles of an image or a text alone."""
    assert isinstance(getattr(_loss(plugin), "weight", None), int | float), "`weight` is not a number; set it"
    results = [stylization(*each) for each in ((1, 2, (80, 80)), (2, 3, (64, 80)), (1, 1, (96, 64)))]
    for result in (*results, stylization(text=False), stylization(image=False)):
        value = _value(plugin, result)
        check_tensor(value, Float[Tensor, ""], "the loss")
        assert value.dtype == torch.float32, f"the loss is {value.dtype}"
        asserts.finite(value, "the loss")


def test_absent_images_are_not_read(plugin: Subject[Loss]) -> None:
    """Where ``style.has_image`` is false, the pixels of that row change nothing."""
    result = stylization(2, 2)
    assert result.style.image is not None
    other = torch.cat([result.style.image[:1], images(1, (48, 40), seed=60)])
    before, after = (
        _value(plugin, replace(result, style=replace(result.style, image=image, has_image=torch.tensor([True, False]))))
        for image in (result.style.image, other)
    )
    asserts.close(after, before, "the loss with other pixels where a style has no image", tolerance=1e-5)


def test_value_is_reproducible(plugin: Subject[Loss]) -> None:
    """After the same seed the same stylization gives the same number, whatever ``weight``, and is left as it was."""
    result = stylization(1, 2)
    before = result.map(lambda tensor: tensor.detach().clone())
    asserts.same(_value(plugin, result), _value(plugin, result), "the same loss again")
    asserts.same(result, before, "the stylization after the loss was computed")
    heavy = copy.copy(_loss(plugin))
    heavy.weight = 3 * heavy.weight
    with seeded(0):
        asserts.same(heavy(result), _value(plugin, result), "the loss of three times the `weight`")


def test_a_batch_has_a_mean(plugin: Subject[Loss]) -> None:
    """A batch of two equal scenes has about the value of one of them, not the sum."""
    one = stylization(1, 2)
    two = one.map(lambda tensor: torch.cat([tensor, tensor]))
    two = replace(two, style=replace(two.style, text=(two.style.text or ()) * 2, names=two.style.names * 2))
    alone, together = (_value(plugin, result).abs().item() for result in (one, two))
    assert together <= 1.5 * alone, f"{together:.4g} for two equal scenes, {alone:.4g} for one; take the mean"


def test_something_learns_from_it(plugin: Subject[Loss]) -> None:
    """It has a finite gradient in the renders, the Gaussians or what the backbone predicted, plain images or not."""
    for white in (0, 40):  # columns, in which a square root of changes is 0 and its derivative infinite
        result = stylization(1, 2)
        result.views.images[..., :white] = result.renders.color.data[..., :white] = 1
        scene = result.scene.map(lambda t: t.detach().clone().requires_grad_(t.is_floating_point()))
        result = replace(result, scene=scene)
        _value(plugin, result).backward()
        gradients = {name: leaf.grad for name, leaf in asserts.tensors_of(result).items() if leaf.grad is not None}
        assert any(bool(gradient.any()) for gradient in gradients.values()), "gradients of 0; is it detached?"
        asserts.finite(gradients, f"the gradients where {white} columns of photographs and renders are white")


@cache
def _loss(plugin: Subject[Loss]) -> Loss:
    return plugin.build(style_encoder=style_encoder()).eval()


def _value(plugin: Subject[Loss], result: Stylization) -> Tensor:
    with seeded(0):
        return _loss(plugin)(result)
