"""Reconstructions of captures, judged on photographs held out."""

import json
from math import isnan

import pytest

import anystyle
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import no_progress
from anystyle_captures.camera_files.samples import write_wall
from anystyle_captures.protocol import Captures
from anystyle_metrics.consistency import Consistency


def test_a_capture_that_the_backbone_cannot_do_is_judged_all_the_same(tmp_path, monkeypatch):
    """The fit's scores stay, those of the single pass are not a number, and its reason is on record."""
    stylizer = anystyle.load("painter")
    stylizer.renderer = ToyRenderer()
    metrics = {"consistency": Consistency()}
    protocol = Captures(stylizer=stylizer, metrics=metrics, control=["consistency"], **Captures.example(tmp_path))

    def refuse(views):
        raise ValueError("cameras run the other way")

    monkeypatch.setattr(stylizer, "encode", refuse)
    evaluation = protocol.run(tmp_path / "out", no_progress)
    fit, single = evaluation.groups["fit"], evaluation.groups["feedforward"]
    assert evaluation.scores.items() > fit.items() and evaluation.n == 1 and evaluation.stand_ins.keys() == {"lpips"}
    assert fit["psnr"] > 10 and fit["matched_psnr"] >= fit["psnr"] - 1e-6 and isnan(single["psnr"])
    record = json.loads((tmp_path / "out" / "captures" / "wall" / "record.json").read_text())
    assert record["costs"]["feedforward"] == {"failed": "cameras run the other way"}
    shown = {row.style: row.pictures.keys() for row in evaluation.rows}
    assert shown["fit"] == {"photograph", "result"} and shown["feedforward"] == {"photograph"}
    kinds = ("photographs", "unstyled", "palette", "stylized", "view_by_view")
    wall = {kind: evaluation.groups[kind]["consistency"] for kind in (*kinds, *(f"control_{kind}" for kind in kinds))}
    assert wall["photographs"] < wall["stylized"] == evaluation.scores["consistency"] < wall["view_by_view"]
    assert not any(map(isnan, wall.values())) and wall["control_photographs"] != wall["photographs"]
    row = {row.style: row.scores for row in evaluation.rows}["view_by_view, example:wave"]
    assert row["consistency"] == wall["view_by_view"]
    over = evaluation.groups["photographs over stylized"]
    assert over["consistency"] == 1 and "consistency_coverage" not in over  # all kinds have the same
    monkeypatch.undo()  # of one capture the backbone failed, and it does not of the next
    for name in ("second", "partial"):
        write_wall(tmp_path / name)
    cameras = json.loads((tmp_path / "partial" / "transforms.json").read_text())
    cameras["frames"].pop()
    (tmp_path / "partial" / "transforms.json").write_text(json.dumps(cameras))
    protocol.captures = [tmp_path / "nothing", tmp_path / "partial", *protocol.captures, tmp_path / "second"]
    protocol.captures[0].mkdir()
    others = Captures.run(protocol, tmp_path / "out", no_progress)
    assert others.provenance["scenes"] == ["wall", "second"]
    assert others.groups["scene wall"] == pytest.approx(evaluation.scores)
    assert "nothing is left out: there are no images in the folder" in others.provenance["warnings"][0]
    assert "1 of 6 photographs have no stored camera: 05; leave" in others.provenance["warnings"][1]
    single = others.groups["feedforward"]
    assert single.keys() == {"psnr", "matched_psnr", "ssim", protocol.lpips.name} and not isnan(single["psnr"])
    del protocol.captures[:2]
    protocol.better["csd"] = "higher"
    with pytest.raises(ValueError, match="judged without csd, by other metrics or networks"):
        protocol.run(tmp_path / "out", no_progress)
