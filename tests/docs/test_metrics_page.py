"""The page of metrics: its examples run, and its list is that of the catalog."""

import inspect
import re
import warnings

from anystyle.registry.catalog import catalog
from tests.support.docs_cases import FENCE, ROOT

TEXT = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")


def test_the_examples_run():
    known = {}
    with warnings.catch_warnings(action="ignore"):  # of stand-ins
        for language, body in FENCE.findall(TEXT):
            if language == "python":
                exec(body, known)
        assert set(known["scores"]) >= {"SSIM", "LPIPS", "art_fid", "style_retrieval"}
        assert 0 < known["match"].compute() < 1
        assert known["warp"].compute()["warp_rmse_short"] < 1e-6


def test_every_metric_is_listed_with_what_it_takes():
    rows = re.findall(r"^\| `(\w+)`, `(\w+)` \| `([^`]*)` \|", TEXT, re.MULTILINE)
    assert sorted(name for _, name, _ in rows) == catalog().names("metric")
    for title, name, taken in rows:
        cls = catalog().find("metric", name).load()
        shown = [
            (each.name, each.default is each.empty)
            for each in inspect.signature(cls.update).parameters.values()
            if each.name != "self"
        ]
        required, _, rest = taken.partition("[, ")
        written = [(word, True) for word in required.split(", ")] + [
            (word, False) for word in rest.rstrip("]").split(", ") if word
        ]
        assert (cls.__name__, shown) == (title, written)
