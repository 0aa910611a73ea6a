"""The two-way cluster bootstrap: participants and items are resampled together, by matrix products.

Resampling both margins of a table (McCullagh 2000; Owen 2007, "the pigeonhole bootstrap") overstates the part of the
variance that belongs to single answers, up to threefold. Studentising cancels this: every resampled mean is divided
by its own two-way standard error, which is overstated alike.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import sparse

from anystyle.study.contract import Responses

_DENSE_CELLS = 4_000_000
_CHUNK_NUMBERS = 4_000_000  # of one temporary array: 32 MB


@dataclass(frozen=True)
class Table:
    """Sums over the answers of each participant (row) to each item (column), dense or sparse.

    Args:
        sums: Of the deviations.
        squares: Of their squares.
        counts: Of the answers.
        shape: Participants and items that have answers.
    """

    sums: np.ndarray | sparse.csr_array
    squares: np.ndarray | sparse.csr_array
    counts: np.ndarray | sparse.csr_array
    shape: tuple[int, int]


def tabulate(responses: Responses, values: Float[np.ndarray, " N"] | None = None) -> Table:
    """The table of ``values``, the deviations unless others are given, by participant and item."""
    values = responses.deviations if values is None else values
    rows, row = np.unique(responses.participants, return_inverse=True)
    columns, column = np.unique(responses.items, return_inverse=True)
    shape = (len(rows), len(columns))

    def matrix(weights: np.ndarray) -> np.ndarray | sparse.csr_array:
        if shape[0] * shape[1] > _DENSE_CELLS:
            return sparse.csr_array(sparse.coo_array((weights, (row, column)), shape=shape))
        flat = np.bincount(row * shape[1] + column, weights=weights, minlength=shape[0] * shape[1])
        return flat.reshape(shape)

    return Table(sums=matrix(values), squares=matrix(values**2), counts=matrix(np.ones_like(values)), shape=shape)


def resample_counts(size: int, resamples: int, generator: np.random.Generator) -> Float[np.ndarray, "R size"]:
    """How often each of ``size`` clusters is drawn, with replacement; a single cluster is always drawn once."""
    if size == 1:
        return np.ones((resamples, 1))
    drawn = generator.integers(0, size, (resamples, size)) + size * np.arange(resamples)[:, None]
    return np.bincount(drawn.ravel(), minlength=resamples * size).reshape(resamples, size).astype(float)


def draws(
    shape: tuple[int, int], resamples: int, generator: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Counts of participants and of items, in chunks of bounded memory."""
    chunk = max(1, min(resamples, _CHUNK_NUMBERS // (sum(shape) + 1)))
    for start in range(0, resamples, chunk):
        rows = min(chunk, resamples - start)
        yield resample_counts(shape[0], rows, generator), resample_counts(shape[1], rows, generator)


def weighted_means(
    table: Table, rows: Float[np.ndarray, "R I"], columns: Float[np.ndarray, "R J"]
) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " R"]]:
    """The mean and its squared two-way standard error, for every pair of row and column weights.

    The variance is that of a mean in a crossed random-effects table: row clusters, plus column clusters, less the
    interaction that both count (Cameron, Gelbach and Miller 2011), with the degrees of freedom that make each part
    unbiased in a complete table. It is never less than the interaction alone.
    """
    num_rows, num_columns = table.shape
    row_sums, row_counts = (table.sums @ columns.T).T, (table.counts @ columns.T).T  # R I
    column_sums, column_counts = (table.sums.T @ rows.T).T, (table.counts.T @ rows.T).T  # R J
    squares = (rows * (table.squares @ columns.T).T).sum(1)
    total = (rows * row_counts).sum(1)
    # A resample of a sparse table may, rarely, hold no answer at all.
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = (rows * row_sums).sum(1) / total
        row_scores = row_sums - mean[:, None] * row_counts
        column_scores = column_sums - mean[:, None] * column_counts
        by_row = (rows * row_scores**2).sum(1)
        by_column = (columns * column_scores**2).sum(1)
        explained = (rows * row_scores**2 / np.maximum(row_counts, 1)).sum(1)
        explained += (columns * column_scores**2 / np.maximum(column_counts, 1)).sum(1)
        interaction = np.maximum(squares - total * mean**2 - explained, 0.0)
        row_part, column_part = num_rows / max(num_rows - 1, 1), num_columns / max(num_columns - 1, 1)
        if min(num_rows, num_columns) == 1:
            variance = by_row * row_part if num_rows > 1 else by_column * column_part
        else:
            single = interaction * row_part * column_part
            variance = np.maximum(by_row * row_part + by_column * column_part - single, single)
        return mean, variance / total**2


@dataclass(frozen=True)
class Bootstrap:
    """A mean with its two-way standard error, and the studentised means of the resamples.

    Args:
        mean: Of all answers.
        error: Its standard error over participants and items.
        studentised: ``(resampled mean - mean) / resampled standard error``, sorted.
    """

    mean: float
    error: float
    studentised: Float[np.ndarray, " R"]

    def interval(self, confidence: float) -> tuple[float, float]:
        """The bootstrap-t interval of the mean."""
        low, high = np.quantile(self.studentised, [(1 - confidence) / 2, (1 + confidence) / 2])
        return self.mean - float(high) * self.error, self.mean - float(low) * self.error

    def tails(self) -> tuple[float, float]:
        """Lower and upper one-sided p-values of no preference; at least ``1 / (R + 1)``."""
        observed, resamples = self.mean / self.error, len(self.studentised)
        lower = int(np.searchsorted(self.studentised, observed, side="right"))
        upper = resamples - int(np.searchsorted(self.studentised, observed, side="left"))
        return (lower + 1) / (resamples + 1), (upper + 1) / (resamples + 1)


def bootstrap_mean(table: Table, *, resamples: int, seed: int) -> Bootstrap | None:
    """Resample participants and items; ``None`` where the answers do not vary between clusters."""
    generator = np.random.default_rng(seed)
    ones = [np.ones((1, size)) for size in table.shape]
    mean, variance = (float(value[0]) for value in weighted_means(table, ones[0], ones[1]))
    if not variance > 1e-24:
        return None
    parts: list[np.ndarray] = []
    for rows, columns in draws(table.shape, resamples, generator):
        means, variances = weighted_means(table, rows, columns)
        usable = variances > 1e-24
        parts.append((means[usable] - mean) / np.sqrt(variances[usable]))
    return Bootstrap(mean=mean, error=variance**0.5, studentised=np.sort(np.concatenate(parts)))


def bootstrap_counts(
    responses: Responses, levels: Float[np.ndarray, " K"], *, resamples: int, seed: int
) -> Float[np.ndarray, "R K"]:
    """How often each answer occurs in every resample of participants and items."""
    generator = np.random.default_rng(seed)
    row, column = (np.unique(codes, return_inverse=True)[1] for codes in (responses.participants, responses.items))
    level = np.searchsorted(levels, responses.deviations)
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    parts = [
        np.bincount(level, row_counts[row] * column_counts[column], len(levels))
        for rows, columns in draws(shape, resamples, generator)
        for row_counts, column_counts in zip(rows, columns, strict=True)
    ]
    return np.stack(parts)
