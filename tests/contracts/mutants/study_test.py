"""Tests of the user study that each break one promise, and what is found."""

from dataclasses import replace

import numpy as np

from anystyle.testing.toy.study_test import ToyStudyTest


class Unitless(ToyStudyTest):
    units = ()


class Crossed(ToyStudyTest):
    def __call__(self, responses):
        result = super().__call__(responses)
        return replace(result, interval=(result.estimate + 0.1, result.estimate + 0.2))


class Silent(ToyStudyTest):
    def __call__(self, responses):
        return replace(super().__call__(responses), method="")


class Reversed(ToyStudyTest):
    def __call__(self, responses):
        return super().__call__(replace(responses, deviations=-responses.deviations))


class Lopsided(ToyStudyTest):
    def __call__(self, responses):
        result = super().__call__(responses)
        spread = 2 * float(np.mean(responses.deviations < 0))
        return replace(result, estimate=result.estimate - 1e-3 * spread)


class Demanding(ToyStudyTest):
    def __call__(self, responses):
        if responses.count < 2:
            raise ZeroDivisionError("no degrees of freedom")
        return super().__call__(responses)


class Restless(ToyStudyTest):
    calls = 0

    def __call__(self, responses):
        self.calls += 1
        return replace(super().__call__(responses), statistic=float(self.calls))


class Sorting(ToyStudyTest):
    def __call__(self, responses):
        result = super().__call__(responses)
        responses.deviations.sort()
        return result


CHANGED = {
    "as it is": (ToyStudyTest, set()),
    "no units": (Unitless, {"units are declared"}),
    "an interval beside the estimate": (Crossed, {"results are complete"}),
    "no method": (Silent, {"results are complete"}),
    "the wrong sign": (Reversed, {"negative means ours"}),
    "not symmetric": (Lopsided, {"negative means ours"}),
    "an error for too little": (Demanding, {"too little is not an error"}),
    "another result each time": (Restless, {"testing twice is the same"}),
    "answers sorted in place": (Sorting, {"testing twice is the same"}),
}
