"""The Fréchet distance between two sets of features, exactly and without a matrix square root."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def frechet_distance(first: Float[Tensor, "N D"], second: Float[Tensor, "M D"]) -> Float[Tensor, ""]:
    """Fréchet distance of the Gaussians fitted to two sets of features, a row a sample (Heusel et al., 2017, Eq. 6).

    With centred and scaled features ``A`` and ``B``, the covariances are ``AᵀA`` and ``BᵀB``, and the trace of
    ``sqrtm(AᵀA BᵀB)`` is the sum of the singular values of ``A Bᵀ``: an N x M matrix, exact also where N < D makes
    both covariances singular, and cheap there. Where both sets are larger than D, the same identity is used on D x D
    square roots from eigenvalues.

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


def frechet_infinity(
    first: Float[Tensor, "N D"], second: Float[Tensor, "M D"], *, smallest: int, points: int = 15
) -> Float[Tensor, ""]:
    """The Fréchet distance extrapolated to endless samples (Chong and Forsyth, CVPR 2020).

    Distances of growing samples, drawn with a fixed seed, lie close to a line over one divided by their size; the
    line's value at 0 is the figure.

    Args:
        first: One row a sample; its samples grow.
        second: One row a sample; all are used.
        smallest: Size of the smallest sample. If there are no more, there is nothing to extrapolate from, and the
            figure is the plain distance.
        points: How many sizes.

    Returns:
        In float64.
    """
    count = first.shape[0]
    if count <= smallest:
        return frechet_distance(first, second)
    # A sum does not depend on the order of rows, but a sample does: rows are sorted, then drawn.
    rows = first[_order(first)]
    generator = torch.Generator().manual_seed(0)
    sizes = torch.linspace(smallest, count, points).round().long().unique().tolist()
    distances = []
    for size in sizes:
        drawn = torch.randperm(count, generator=generator)[:size].to(first.device)
        distances.append(frechet_distance(rows[drawn], second))
    inverse = 1 / torch.tensor(sizes, dtype=torch.float64, device=first.device)
    design = torch.stack([torch.ones_like(inverse), inverse], dim=1)
    return torch.linalg.lstsq(design, torch.stack(distances)[:, None]).solution[0, 0]


def _order(rows: Float[Tensor, "N D"]) -> Int[Tensor, " N"]:
    return rows.double().mean(1).argsort(stable=True)


def _scaled(features: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    features = features.double()
    return (features - features.mean(0)) / (features.shape[0] - 1) ** 0.5


def _compact(scaled: Float[Tensor, "N D"]) -> Float[Tensor, "R D"]:
    """A matrix with the same Gram matrix ``AᵀA`` and at most D rows."""
    rows, dim = scaled.shape
    if rows <= dim:
        return scaled
    return torch.linalg.qr(scaled, mode="r").R
