"""The statistics against R: ``r/goldens.R`` made ``r/goldens.json``, which holds the versions."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from anystyle_study.contract import Responses
from anystyle_study.significance import OneSampleT, Wilcoxon
from anystyle_study.statistics import Crossing
from tests.support.study_cases import table

GOLDENS = json.loads((Path(__file__).parent / "r" / "goldens.json").read_text())
STUDIES = GOLDENS["studies"]
ENDS = {"-Inf": -math.inf, "Inf": math.inf}


def responses(name: str) -> Responses:
    rows = {column: np.array(values) for column, values in STUDIES[name]["rows"].items()}
    items = int(rows["item"].max()) + 1
    scenes, styles = (np.zeros(items, dtype=int) for _ in range(2))
    scenes[rows["item"]], styles[rows["item"]] = rows["scene"], rows["style"]
    return Responses(
        question="golden",
        deviations=rows["deviation"].astype(float),
        participants=rows["participant"],
        items=rows["item"],
        ours_is_a=rows["position"] > 0,
        participant_names=tuple(map(str, range(int(rows["participant"].max()) + 1))),
        item_names=tuple(map(str, range(items))),
        item_scenes=tuple(map(str, scenes)),
        item_styles=tuple(map(str, styles)),
    )


@pytest.mark.parametrize("unit", ["participant", "response"])
@pytest.mark.parametrize("name", STUDIES)
def test_t_and_wilcoxon_equal_r(name, unit):
    for alternative, golden in STUDIES[name][f"{unit}s"].items():
        rows = responses(name).at(unit)
        t = OneSampleT(alternative=alternative.replace(".", "-"))(rows)
        assert (t.statistic, t.pvalue) == pytest.approx((golden["t"], golden["t_p"]), rel=1e-9)
        assert t.interval == pytest.approx([ENDS.get(end, end) for end in golden["t_interval"]], rel=1e-9)
        w = Wilcoxon(alternative=alternative.replace(".", "-"), method="approx")(rows)
        assert (w.statistic, w.pvalue) == pytest.approx((golden["w"], golden["w_p"]), rel=1e-9)


def test_the_exact_wilcoxon_test_and_its_interval_equal_r():
    golden = GOLDENS["exact"]
    result = Wilcoxon()(table(np.array(golden["values"])[:, None]))
    assert (result.pvalue, result.estimate) == pytest.approx((golden["p"], golden["median"]), rel=1e-9)
    assert result.interval == pytest.approx(golden["interval"], abs=1e-9)


def test_the_crossed_mean_of_a_complete_table_equals_lmer():
    golden, rows = STUDIES["complete"]["crossed"], responses("complete")
    crossed = Crossing(factors=rows.factors).mean(rows.deviations)
    assert crossed.mean == pytest.approx(golden["mean"], abs=1e-9)
    assert crossed.error == pytest.approx(golden["error"], rel=1e-4)
    names = ("participant", "item", "scene", "style", "Residual")
    assert crossed.components == pytest.approx([golden["components"][name] for name in names], rel=2e-3, abs=2e-5)


def test_the_crossed_mean_of_an_incomplete_table_is_near_lmer():
    """REML weighs participants and items otherwise than moments do: the same to a part of a standard error."""
    golden, rows = STUDIES["incomplete"]["crossed"], responses("incomplete")
    crossed = Crossing(factors=rows.factors).mean(rows.deviations)
    assert crossed.mean == pytest.approx(golden["mean"], abs=0.25 * golden["error"])
    assert crossed.error == pytest.approx(golden["error"], rel=0.15)
