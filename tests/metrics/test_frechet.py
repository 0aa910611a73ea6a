import numpy as np
import pytest
import scipy.linalg
import torch

from anystyle.metrics.art_fid import frechet_distance


def by_definition(first, second):
    first, second = first.double().numpy(), second.double().numpy()
    covariances = np.cov(first, rowvar=False), np.cov(second, rowvar=False)
    root = scipy.linalg.sqrtm(covariances[0] @ covariances[1])
    gap = first.mean(0) - second.mean(0)
    return gap @ gap + np.trace(covariances[0]) + np.trace(covariances[1]) - 2 * np.trace(root).real


@pytest.mark.parametrize(("n", "m", "dim"), [(40, 60, 24), (200, 30, 24), (300, 300, 24)])
def test_equals_the_matrix_square_root(n, m, dim):
    generator = torch.Generator().manual_seed(n)
    first = torch.randn(n, dim, generator=generator, dtype=torch.float64)
    second = 0.5 * torch.randn(m, dim, generator=generator, dtype=torch.float64) + 0.3
    np.testing.assert_allclose(frechet_distance(first, second).item(), by_definition(first, second), rtol=1e-9)


def test_a_set_and_itself_are_at_distance_zero_even_if_singular():
    features = torch.randn(20, 64, dtype=torch.float64)
    assert abs(frechet_distance(features, features).item()) < 1e-9


def test_known_gaussians():
    """Two sets that differ by a shift d are at distance |d|^2; by a scale s, at (1 - s)^2 tr C."""
    features = torch.randn(500, 8, dtype=torch.float64)
    np.testing.assert_allclose(frechet_distance(features, features + 2).item(), 8 * 4, rtol=1e-9)
    spread = torch.trace(torch.cov(features.T)).item()
    centred = features - features.mean(0)
    np.testing.assert_allclose(frechet_distance(centred, 3 * centred).item(), 4 * spread, rtol=1e-9)


def test_too_few_samples_and_bad_values_are_refused():
    with pytest.raises(ValueError, match="1 samples"):
        frechet_distance(torch.zeros(1, 4), torch.zeros(5, 4))
    with pytest.raises(ValueError, match="not finite"):
        frechet_distance(torch.full((3, 4), torch.nan), torch.zeros(5, 4))
