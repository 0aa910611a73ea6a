"""Two one-sided tests of equivalence."""

import math
from typing import ClassVar

from scipy import special

from anystyle.study.contract import Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.effects import cohens_d_interval
from anystyle.study.probability import log_t_cdf


class Equivalence(StudyTest):
    """Two one-sided t tests (TOST): a small p-value says that the preference lies within the margin, either way.

    "Not significantly different" never shows that two methods are comparable; this does.

    Args:
        margin: The largest mean deviation, in points of the answer scale, that still counts as comparable.
        confidence: Of the test, so that the interval is at ``2 * confidence - 1``: 90 % for a test at 5 %.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant", "item")

    def __init__(self, *, margin: float = 0.5, confidence: float = 0.95) -> None:
        if not margin > 0:
            raise ValueError(f"margin {margin:g}: expected a positive number of points of the answer scale")
        self.margin = margin
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the mean deviation lies beyond the margin on either side."""
        values, n = responses.deviations, responses.count
        method = f"two one-sided t tests (TOST), margin {self.margin:g} points either way"
        sd = float(values.std(ddof=1)) if n > 1 else 0.0
        if sd <= 1e-14:
            reason = f"{n} {responses.unit}(s) whose means do not vary: an equivalence test needs some variation"
            return TestResult.untestable(responses, reason=reason, alternative="equivalence", method=method)
        mean, error = float(values.mean()), sd / math.sqrt(n)
        # The nearer margin decides: its statistic has the larger p-value.
        statistic = (abs(mean) - self.margin) / error
        half_width = float(special.stdtrit(n - 1, self.confidence)) * error
        return TestResult(
            unit=responses.unit,
            statistic=statistic,
            log_pvalue=log_t_cdf(statistic, n - 1),
            alternative="equivalence",
            estimate=mean,
            interval=(mean - half_width, mean + half_width),
            effect=mean / sd,
            effect_name="cohens_d",
            effect_interval=cohens_d_interval(mean / error, n, 2 * self.confidence - 1),
            n=n,
            confidence=2 * self.confidence - 1,
            method=method,
            generalizes_to=generalization(responses.unit),
        )
