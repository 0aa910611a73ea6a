"""Options and results that the built-in tests share."""

from typing import Any

from anystyle.errors import UserError
from anystyle_study.contract import Alternative, Responses, StudyTest, TestResult, generalization


class Significance(StudyTest):
    """A test with an alternative hypothesis and a confidence level.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Level of the intervals.
    """

    def __init__(self, *, alternative: Alternative = "two-sided", confidence: float = 0.95) -> None:
        if not 0 < confidence < 1:
            raise UserError(f"confidence={confidence}: expected a number between 0 and 1, such as 0.95")
        self.alternative: Alternative = alternative
        self.confidence = confidence

    def result(self, responses: Responses, **values: Any) -> TestResult:
        """A result with this test's options; ``values`` are the other fields and may override the defaults."""
        defaults = {
            "unit": responses.unit,
            "n": responses.count,
            "generalizes_to": generalization(responses.unit),
            "alternative": self.alternative,
            "confidence": self.confidence,
        }
        return TestResult(**(defaults | values))

    def untestable(self, responses: Responses, reason: str, method: str) -> TestResult:
        """A result without a p-value."""
        return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
