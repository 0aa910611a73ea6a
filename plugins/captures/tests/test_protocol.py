"""Reconstructions of captures, judged on photographs held out."""

import json
from math import isnan

import pytest

import anystyle
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import no_progress
from anystyle_captures.protocol import Captures


def test_a_capture_that_the_backbone_cannot_do_is_judged_all_the_same(tmp_path, monkeypatch):
    """The fit's scores stay, those of the single pass are not a number, and its reason is on record."""
    stylizer = anystyle.load("painter")
    stylizer.renderer = ToyRenderer()
    protocol = Captures(stylizer=stylizer, **Captures.example(tmp_path))

    def refuse(views):
        raise ValueError("cameras run the other way")

    monkeypatch.setattr(stylizer, "encode", refuse)
    evaluation = protocol.run(tmp_path / "out", no_progress)
    fit, single = evaluation.groups["fit"], evaluation.groups["feedforward"]
    assert evaluation.scores == fit and evaluation.n == 1 and evaluation.stand_ins.keys() == {"lpips"}
    assert fit["psnr"] > 10 and fit["matched_psnr"] >= fit["psnr"] - 1e-6 and isnan(single["psnr"])
    record = json.loads((tmp_path / "out" / "captures" / "wall" / "record.json").read_text())
    assert record["costs"]["feedforward"] == {"failed": "cameras run the other way"}
    assert [row.pictures.keys() for row in evaluation.rows] == [{"photograph", "result"}, {"photograph"}]
    protocol.lpips.name = "st_lpips"
    with pytest.raises(ValueError, match="another network than st_lpips's, or an earlier version; delete it"):
        protocol.run(tmp_path / "out", no_progress)
