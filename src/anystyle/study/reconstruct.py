"""Which answers could have given published statistics: every distribution over the scale that does."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special


@dataclass(frozen=True)
class Rounded:
    """A p-value as printed.

    Args:
        value: Such as 3.47e-40.
        digits: Significant ones; two p-values are the same if they round alike.
    """

    value: float
    digits: int = 3

    def bounds(self) -> tuple[float, float]:
        """The p-values that are printed like this."""
        unit = 10.0 ** (np.floor(np.log10(self.value)) - self.digits + 1)
        return self.value - unit / 2, self.value + unit / 2

    def matches(self, pvalue: float) -> bool:
        """Whether a p-value is printed like this."""
        return f"{pvalue:.{self.digits - 1}e}" == f"{self.value:.{self.digits - 1}e}"


def answer_counts(total: int, t_test: Rounded, wilcoxon: Rounded) -> np.ndarray:
    """Every way to give ``total`` answers from 1 to 5 that has the published p-values.

    The two are those of the one-sided (``less``) one-sample t test against 3 and of the one-sided Wilcoxon
    signed-rank test with ``zero_method="wilcox"`` and the normal approximation.

    The t statistic depends on the sum and the sum of squares alone: few pairs of them fit the first p-value, each
    leaves two counts free, and those are tried out.

    Returns:
        One row a solution, the counts of the answers 1 to 5; first the one that is nearest to normal opinions rounded
        to the scale.
    """
    found: list[tuple[float, tuple[int, ...]]] = []
    for sum_, squares in _moments(total, t_test):
        one, five = np.meshgrid(np.arange(squares // 4 + 1), np.arange(squares // 4 + 1), indexing="ij")
        inner, slope = squares - 4 * (one + five), sum_ + 2 * one - 2 * five
        # n2 + n4 and n4 - n2 follow from the two sums; both counts have to be whole and none negative.
        fits = (inner >= np.abs(slope)) & ((inner - slope) % 2 == 0) & (one + five + inner <= total)
        for n1, n5, rest, lean in zip(one[fits], five[fits], inner[fits], slope[fits], strict=True):
            counts = np.array([n1, (rest - lean) // 2, total - n1 - n5 - rest, (rest + lean) // 2, n5])
            if _wilcoxon_matches(counts, wilcoxon):
                found.append((_oddness(counts), tuple(int(count) for count in counts)))
    return np.array([counts for _, counts in sorted(found)], dtype=int).reshape(-1, 5)


def _moments(total: int, t_test: Rounded) -> Iterator[tuple[int, int]]:
    """Sums and sums of squares of the deviations whose t test has the p-value."""
    low, high = (float(special.stdtrit(total - 1, bound)) for bound in t_test.bounds())
    for sum_ in range(-2 * total, 0):
        # t = sum / sqrt(total * variance) gives the variance, and it the sum of squares.
        squares = [(total - 1) * sum_**2 / (total * t**2) + sum_**2 / total for t in (low, high)]
        for square in range(int(np.ceil(min(squares))), int(np.floor(max(squares))) + 1):
            if square <= 4 * total:
                yield sum_, square


def _oddness(counts: np.ndarray) -> float:
    """Pearson's distance from a rounded normal opinion of the same mean and variance."""
    answers, total = np.arange(-2, 3), counts.sum()
    mean = counts @ answers / total
    sd = np.sqrt(max(counts @ (answers - mean) ** 2 / total - 1 / 12, 1e-3))
    cumulative = special.ndtr((np.array([-1.5, -0.5, 0.5, 1.5]) - mean) / sd)
    expected = total * np.diff(np.concatenate([[0.0], cumulative, [1.0]]))
    return float(((counts - expected) ** 2 / np.maximum(expected, 1e-3)).sum())


def _wilcoxon_matches(counts: np.ndarray, wilcoxon: Rounded) -> bool:
    small, large = counts[1] + counts[3], counts[0] + counts[4]
    n = small + large
    plus = counts[3] * (small + 1) / 2 + counts[4] * (small + (large + 1) / 2)
    ties = (small**3 - small + large**3 - large) / 2
    sd = np.sqrt((n * (n + 1) * (2 * n + 1) - ties) / 24)
    return wilcoxon.matches(float(special.ndtr((plus - n * (n + 1) / 4) / sd)))
