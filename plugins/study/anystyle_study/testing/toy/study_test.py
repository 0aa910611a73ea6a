"""The sign test: how often ours won, against the toss of a coin."""

from typing import Annotated, ClassVar

import numpy as np
from scipy.stats import binom, binomtest

from anystyle.ranges import Range
from anystyle_study.contract import Responses, StudyTest, TestResult, Unit, generalization


class ToyStudyTest(StudyTest):
    """The exact sign test on mean answers; the estimate is their median.

    Args:
        confidence: Level of the interval of the median.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant", "item")

    def __init__(self, *, confidence: Annotated[float, Range(gt=0, lt=1)] = 0.95) -> None:
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        values = responses.deviations
        ours, decided = int((values < 0).sum()), int((values != 0).sum())
        if decided < 2:
            return TestResult.untestable(responses, reason="fewer than two prefer either", alternative="less")
        test = binomtest(ours, decided, alternative="greater")
        # The median lies between the k-th values from both ends with at least this confidence, where k is not below 1.
        rank = max(int(binom.ppf((1 - self.confidence) / 2, len(values), 0.5)), 1) - 1
        low, high = np.sort(values)[[rank, len(values) - 1 - rank]]
        return TestResult(
            unit=responses.unit,
            statistic=float(ours),
            pvalue=float(test.pvalue),
            alternative="less",
            estimate=float(np.median(values)),
            interval=(float(low), float(high)),
            effect=ours / decided,
            effect_name="share_preferring_ours",
            effect_interval=tuple(test.proportion_ci(self.confidence)),
            n=decided,
            confidence=self.confidence,
            method="exact sign test, ties left out",
            generalizes_to=generalization(responses.unit),
        )
