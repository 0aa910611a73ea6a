"""Gram matrices and quantiles against closed forms and SciPy."""

import numpy as np
import pytest
import torch
from scipy.stats import wasserstein_distance

from anystyle.testing.oracle import hashed
from anystyle_methods.gram import gram
from anystyle_methods.sliced_wasserstein import sliced_quantiles, unit_directions


def test_gram_is_the_mean_of_outer_products() -> None:
    features = hashed(5, [2, 3, 4, 5], -1, 1)
    expected = np.zeros((2, 3, 3))
    for row in range(4):
        for column in range(5):
            vectors = features[:, :, row, column].numpy()
            expected += np.einsum("mi,mj->mij", vectors, vectors) / 20
    torch.testing.assert_close(gram(features), torch.from_numpy(expected).float())


def test_sliced_quantiles_give_the_wasserstein_distance_of_scipy() -> None:
    first, second = hashed(6, [1, 3, 10, 20], 0, 1), hashed(7, [1, 3, 10, 20], 0, 1) ** 2
    directions = unit_directions(5, 3, torch.Generator().manual_seed(3))
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(5))
    distance = (sliced_quantiles(first, directions, 200) - sliced_quantiles(second, directions, 200)).abs().mean(-1)
    for place, direction in enumerate(directions):
        expected = wasserstein_distance(
            (direction @ first.flatten(2)[0]).numpy(), (direction @ second.flatten(2)[0]).numpy()
        )
        assert distance[0, place].item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_sliced_quantiles_and_their_gradient_are_those_of_sorting(dtype: torch.dtype) -> None:
    features = hashed(9, [2, 3, 5, 7]).to(dtype).requires_grad_()
    directions = unit_directions(4, 3, torch.Generator().manual_seed(0)).to(dtype)
    share = hashed(10, [2, 4, 35]).to(dtype)
    found = sliced_quantiles(features, directions, 35)
    expected = (directions @ features.flatten(2)).sort(dim=-1).values
    assert found.equal(expected) and sliced_quantiles(features.detach(), directions, 35).equal(expected)
    (gradient,), (wanted,) = (torch.autograd.grad((value * share).sum(), features) for value in (found, expected))
    torch.testing.assert_close(gradient, wanted)
