"""Scores of rows, scenes and all: each image is seen once, and nothing bad passes in silence."""

import warnings
from collections import Counter

import pytest
import torch

from anystyle.evaluation.comparisons import Reader
from anystyle.evaluation.judge import judge, judge_pairing, judge_scene, mean
from anystyle.evaluation.pairing import Pairing, pair
from anystyle.testing.inputs import comparison
from anystyle.testing.toy.metric import ToyMetric
from anystyle.types import Comparison, no_progress
from tests.support.evaluation_cases import Mean, folders


def test_rows_scenes_and_all_are_what_a_metric_says_of_them(tmp_path):
    cells = pair(*folders(tmp_path)).cells
    comparisons = [Reader()(cell) for cell in cells]
    found = judge({"toy": ToyMetric()}, comparisons)

    def alone(*rows):
        metric = ToyMetric()
        for row in rows:
            metric.update(row)
        return pytest.approx(float(metric.compute()), rel=1e-6)

    assert [(row.scene, row.style) for row in found.rows] == [(cell.scene, cell.style) for cell in cells]
    assert [row.scores["change"] for row in found.rows] == [alone(row) for row in comparisons]
    assert found.groups["scene one"]["change"] == alone(*comparisons[:2])
    assert found.groups["scene two"]["change"] == alone(*comparisons[2:])
    scenes = [found.groups[f"scene {name}"]["change"] for name in ("one", "two")]
    assert found.scores == {"change": pytest.approx(sum(scenes) / 2)}
    assert found.n == 12 and found.better == {"change": "lower"}
    mixed = judge_pairing({"toy": ToyMetric()}, Pairing((*cells[::2], *cells[1::2])), no_progress)
    assert {name: dict(scores) for name, scores in mixed.groups.items()} == found.groups


def test_warnings_of_metrics_are_kept_once_and_not_those_of_rows():
    class Loud(Mean):
        def update(self, given):
            super().update(given)
            warnings.warn("a row's own warning", stacklevel=1)

        def compute(self):
            warnings.warn(f"{len(self.values)} values are few", stacklevel=1)
            return super().compute()

    rows = [row_of(comparison(2, 2), 0, style=style) for style in ("style", "other")]
    for number in (1, 2):
        found = judge({"loud": Loud()}, rows[:number])
        assert found.provenance["warnings"] == ["a row's own warning", f"{number} values are few"]


@pytest.mark.parametrize("call", [("update", 1), ("update", 2), ("compute", 1), ("compute", 2), ("compute", 3)])
def test_a_metric_that_raises_takes_no_scores_of_the_others(call):
    """The third time, scores are computed for the scene."""

    class Fragile(Mean):
        def __init__(self):
            super().__init__()
            self.calls = Counter()

        def update(self, given):
            self.fail("update")
            super().update(given)

        def compute(self):
            self.fail("compute")
            return super().compute()

        def fail(self, step):
            self.calls[step] += 1
            if (step, self.calls[step]) == call:
                raise ValueError("too small")

    rows = [row_of(comparison(1, 2), 0, style=style) for style in ("one", "other")]
    failed = []
    metrics = {"fragile": Fragile(), "mean": Mean()}
    found = judge_scene(metrics, rows, lambda name, error: failed.append((name, str(error))))
    assert found == judge_scene({"mean": Mean()}, rows) and failed == [("fragile", "too small")]
    with pytest.raises(ValueError, match="too small"):
        judge_scene({"fragile": Fragile(), "mean": Mean()}, rows)


def row_of(given: Comparison, row: int, style: str = "style") -> Comparison:
    one = given.map(lambda tensor: tensor[row : row + 1])
    return Comparison(one.content, one.stylized, scenes=(f"scene_{row}",), styles=(style,))


@pytest.mark.parametrize(("what", "name"), [("content", "photographs"), ("stylized", "stylized images")])
def test_images_that_are_no_numbers_are_refused(what, name):
    given = row_of(comparison(1, 2), 0)
    getattr(given, what)[0, 1, 0, 3, 3] = float("inf")
    with pytest.raises(ValueError, match=f"scene_0 in style style: the {name} hold 1 values that are NaN or infinite"):
        judge({"toy": ToyMetric()}, [given])


def test_nothing_and_sizes_that_differ_are_refused():
    with pytest.raises(ValueError, match="nothing to judge"):
        judge({"toy": ToyMetric()}, [])
    given = row_of(comparison(1, 3), 0)
    # As it can be made where no test's hook checks shapes.
    object.__setattr__(given, "content", given.content[:, :2])
    told = "scene_0 in style style: photographs are 1 x 2 of 80x64 .* 1 x 3 of 80x64 pixels"
    with pytest.raises(ValueError, match=told):
        judge({"toy": ToyMetric()}, [given])


def test_a_scene_without_a_score_is_told():
    class Half(Mean):
        def compute(self):
            scores = super().compute()
            return scores if self.seen[-1][0] == "scene_0" else {"mean": torch.tensor(float("nan"))}

    given = comparison(2, 2)
    found = judge({"half": Half()}, [row_of(given, 0), row_of(given, 1)])
    assert found.scores["mean"] == found.groups["scene scene_0"]["mean"]
    told = "mean is the mean over the scenes without scene_1, which have too little for it"
    assert found.provenance["warnings"] == [told]
    assert mean([float("nan")]) != mean([float("nan")])


def test_no_metric_is_an_error(tmp_path):
    with pytest.raises(ValueError, match=r"no metric is chosen; add metric=\[NAME"):
        judge_pairing({}, pair(*folders(tmp_path / "images")), no_progress)
