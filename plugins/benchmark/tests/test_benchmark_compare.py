"""Methods differ where the interval of the difference says so."""

import csv
import gzip
import json

import msgspec
import numpy as np
import pytest

from anystyle.errors import UserError
from anystyle_benchmark.command_compare import compare, main, sentences
from anystyle_benchmark.results import Figures, read_figures
from anystyle_study.statistics import Crossing, holm, t_pvalue


@pytest.fixture(scope="module")
def figures(world):
    return msgspec.json.decode((world[1] / "figures.json").read_bytes(), type=Figures)


def test_differences_are_paired_by_cell_and_adjusted_over_figures(figures):
    found = compare(figures, ["unstyled", "noise"])
    by_name = {(one.guide, one.figure): one for one in found}
    values = {cell.cell: cell.figures["color_match"] for cell in figures.cells if cell.guide == "image"}
    places = sorted({(cell.scene, cell.style) for cell in values})
    noise = np.mean([[values["noise", seed, *place] for place in places] for seed in (0, 1)], axis=0)
    gaps = np.array([values["unstyled", 0, *place] for place in places]) - noise
    scenes, styles = (np.unique(names, return_inverse=True)[1] for names in zip(*places, strict=True))
    crossed = Crossing(factors={"scenes": scenes, "styles": styles}).mean(gaps)
    color = by_name["image", "color_match"]
    assert (color.n, color.difference) == (9, pytest.approx(gaps.mean(), rel=1e-6))
    assert color.pvalue == pytest.approx(t_pvalue(float(crossed.mean / crossed.error), float(crossed.df), "two-sided"))
    assert [color.low, color.high] == pytest.approx(crossed.interval(0.95))
    expected = holm([np.nan if one.pvalue is None else one.pvalue for one in found])
    assert [np.nan if one.holm is None else one.holm for one in found] == pytest.approx(expected, nan_ok=True)
    warp = by_name["image", "warp_rmse_short"]
    assert (warp.better, warp.n) == ("unstyled", 6)  # one scene has no geometry
    assert by_name["image", "kid"].n == 3
    assert all(one.better == "" for one in found if one.holm is None or one.holm > 0.05)
    lines = sentences(found)
    assert lines[0].startswith("unstyled and noise, by images: unstyled is better by ")
    assert "cannot be told apart by" in lines[0]


def test_a_method_is_not_told_from_itself(figures):
    twins = [msgspec.structs.replace(cell, method="twin") for cell in figures.cells if cell.method == "unstyled"]
    doubled = msgspec.structs.replace(
        figures, cells=[*figures.cells, *twins], methods=figures.methods | {"twin": figures.methods["unstyled"]}
    )
    found = compare(doubled, ["unstyled", "twin"])
    assert {(one.difference, one.better, one.holm) for one in found} == {(0.0, "", None)}
    assert sentences(found)[0] == "unstyled and twin, by images: they cannot be told apart by any score."


def test_the_table_is_written_in_every_form(world, tmp_path, capsys):
    main([str(world[1]), "noise", "pasted", "unstyled", "--out", str(tmp_path)])
    assert (tmp_path / "compare.md").read_text() == capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "compare.csv").read_text().splitlines()))
    found = json.loads((tmp_path / "compare.json").read_text())["figures"]
    assert len(rows) == len(found) and {(row["methods"], row["guide"]) for row in rows} >= {("noise, pasted", "image")}
    assert {one["figure"] for one in found} >= {"kid", "color_match"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["noise"], "name two methods or more"),
        (["noise", "noise"], "each once"),
        (["noise", "pastel"], "Did you mean 'pasted'"),
    ],
)
def test_slips_are_one_line(world, words, message):
    with pytest.raises(UserError, match=message):
        main([str(world[1]), *words])


def test_what_was_not_judged_cannot_be_compared(tmp_path):
    with pytest.raises(UserError, match=r"there is no .*figures\.json; run `anystyle benchmark judge .*` first"):
        main([str(tmp_path), "noise", "pasted"])


def test_methods_without_a_common_cell_cannot_be_compared(figures):
    cells = [cell for cell in figures.cells if cell.method != "noise" or cell.scene == "scene0"]
    cells = [cell for cell in cells if cell.method != "pasted" or cell.scene == "scene1"]
    apart = msgspec.structs.replace(figures, cells=cells, scenes=[])
    with pytest.raises(UserError, match="noise and pasted have no score in the same cell"):
        compare(apart, ["unstyled", "noise", "pasted"])


def test_packed_scores_are_read_as_they_were(world, figures, tmp_path):
    packed = tmp_path / "figures.json.gz"
    packed.write_bytes(gzip.compress((world[1] / "figures.json").read_bytes()))
    assert read_figures(tmp_path) == read_figures(packed) == figures
    packed.write_bytes(packed.read_bytes()[:1000])
    with pytest.raises(UserError, match=r"figures\.json\.gz is not a valid packed file"):
        read_figures(tmp_path)
