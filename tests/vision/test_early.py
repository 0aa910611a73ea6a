"""Gradients that are computed at once are those that are computed at the end."""

import weakref

import torch

from anystyle.testing.oracle import hashed
from anystyle.vision.eager_backward import eager_backward

IMAGES = hashed(1, (3, 3, 8, 10))


def distance(images: torch.Tensor) -> torch.Tensor:
    return (images.sin() * images.square()).mean()


def test_value_and_gradient_are_those_of_the_function():
    early, late = (IMAGES.clone().requires_grad_() for _ in range(2))
    found, expected = (3 * eager_backward(distance, 2 * early)) ** 2, (3 * distance(2 * late)) ** 2
    assert torch.equal(found, expected)
    for value in (found, expected):
        value.backward()
    torch.testing.assert_close(early.grad, late.grad, rtol=1e-6, atol=0)


def test_what_the_function_kept_is_gone_before_anything_is_differentiated():
    kept = []

    def keeping(images):
        inside = images.exp()
        kept.append(weakref.ref(inside))
        return inside.mean()

    value = eager_backward(keeping, IMAGES.clone().requires_grad_())
    assert kept[0]() is None and value.requires_grad
