"""The Fréchet distance between two sets of features, exactly and without a matrix square root."""

import torch
from jaxtyping import Float
from torch import Tensor


def frechet_distance(first: Float[Tensor, "N D"], second: Float[Tensor, "M D"]) -> Float[Tensor, ""]:
    """Fréchet distance of the Gaussians fitted to two sets of features (Heusel et al., 2017, Eq. 6).

    With centred and scaled features ``A`` and ``B``, the covariances are ``AᵀA`` and ``BᵀB``, and the trace of
    ``sqrtm(AᵀA BᵀB)`` is the sum of the singular values of ``A Bᵀ``: an N x M matrix, exact also where N < D makes
    both covariances singular, and cheap there. Where both sets are larger than D, the same identity is used on D x D
    square roots from eigenvalues.

    Args:
        first: One row a sample.
        second: One row a sample.

    Returns:
        In float64; covariances are the unbiased ones.

    Raises:
        ValueError: A set has fewer than two samples, or holds a value that is not finite.
    """
    for name, features in (("first", first), ("second", second)):
        if features.shape[0] < 2:
            raise ValueError(f"the {name} set has {features.shape[0]} samples; a covariance needs at least 2")
        if not features.isfinite().all():
            raise ValueError(f"the {name} set of features holds values that are not finite")
    mean_gap = (first.double().mean(0) - second.double().mean(0)).square().sum()
    a, b = _scaled(first), _scaled(second)
    spread = a.square().sum() + b.square().sum()
    return mean_gap + spread - 2 * torch.linalg.svdvals(_compact(a) @ _compact(b).T).sum()


def _scaled(features: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    features = features.double()
    return (features - features.mean(0)) / (features.shape[0] - 1) ** 0.5


def _compact(scaled: Float[Tensor, "N D"]) -> Float[Tensor, "R D"]:
    """A matrix with the same Gram matrix ``AᵀA`` and at most D rows."""
    rows, dim = scaled.shape
    if rows <= dim:
        return scaled
    return torch.linalg.qr(scaled, mode="r").R
