"""Methods differ where the interval of the difference says so, and people are asked by a study of two methods."""

import json

import msgspec
import numpy as np
import pytest

from anystyle.errors import UserError
from anystyle_benchmark.command_compare import compare, main, sentences
from anystyle_benchmark.results import Figures
from anystyle_study.protocol import read_study
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
    assert sentences(found)[0] == "unstyled and twin, by images: they cannot be told apart by any figure."


def answered(study, folder, prefers):
    """Everybody answers as the form saves it: this method is better, but for one answer in seven."""
    folder.mkdir()
    for number, participant in enumerate(study.participants):
        rows = []
        for turn, item in enumerate(participant.order):
            ours = (item in participant.ours_is_a) == (study.ours == prefers)
            score = (1 if ours else 5) if (turn + number) % 7 else 3
            rows += [{"item": item, "question": question.name, "score": score} for question in study.plan.questions]
        answers = {"study": study.id, "participant": participant.id, "responses": rows}
        (folder / f"{participant.id}.json").write_text(json.dumps(answers))


def test_people_are_asked_and_their_answers_stand_beside_the_figures(world, tmp_path, capsys):
    track, results = world
    plan = ["study=pilot", "participants=8", "degraded=0", "repeats=0", "sets=12", "image_size=64"]
    out = tmp_path / "study"
    main([str(results), "noise", "pasted", "--with-people", str(out), "--track", str(track), *plan])
    assert "noise against pasted: 12 sets for 8 participants" in capsys.readouterr().out
    study = read_study(out)
    assert {item.scene for item in study.items} == {"scene0", "scene1", "scene2"}
    assert [item.text for item in study.items if item.style == "text0"] == ["thick strokes in deep blue"] * 3
    with pytest.raises(UserError, match="has no answers beside it"):
        main([str(results), "noise", "pasted", "--answers", str(out)])
    answered(study, out / "answers", prefers="pasted")
    main([str(results), "noise", "pasted", "--answers", str(out), "--out", str(tmp_path / "compared")])
    shown = capsys.readouterr().out
    assert "**people prefer noise or pasted**" in shown
    assert "- noise and pasted, overall: people prefer pasted." in shown
    document = json.loads((tmp_path / "compared" / "compare.json").read_text())
    assert (tmp_path / "compared" / "compare.md").read_text().rstrip() in shown
    (overall,) = [one for one in document["people"] if one["question"] == "overall"]
    assert overall["preference"] < -1 and overall["high"] < 0 and overall["participants"] == 8
    assert {one["figure"] for one in document["figures"]} >= {"kid", "color_match"}
    # What was analysed already, and the other way round.
    main([str(results), "pasted", "noise", "--answers", str(out / "analysis"), "--out", str(tmp_path / "turned")])
    document = json.loads((tmp_path / "turned" / "compare.json").read_text())
    (turned,) = [one for one in document["people"] if one["question"] == "overall"]
    assert (turned["preference"], turned["better"]) == (-overall["preference"], "pasted")
    assert (turned["low"], turned["high"]) == (-overall["high"], -overall["low"])
    with pytest.raises(UserError, match="of a study of noise against pasted, not of two of these"):
        main([str(results), "pasted", "unstyled", "--answers", str(out / "analysis")])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["noise"], "name two methods or more"),
        (["noise", "noise"], "each once"),
        (["noise", "pastel"], "Did you mean 'pasted'"),
        (["noise", "pasted", "sets=4"], "needs --with-people"),
        (["noise", "--with-people", "OUT", "--track", "TRACK"], "name two or more"),
        (["noise", "pasted", "unstyled", "--with-people", "OUT", "--track", "TRACK"], "plan at most 36 sets"),
        (["noise", "pastel", "--with-people", "OUT", "--track", "TRACK"], "Did you mean 'pasted'"),
        (["noise", "pasted", "--answers", "OUT"], "there is no"),
    ],
)
def test_slips_are_one_line(world, tmp_path, words, message):
    places = {"OUT": str(tmp_path / "out"), "TRACK": str(world[0])}
    with pytest.raises(UserError, match=message):
        main([str(world[1]), *(places.get(word, word) for word in words)])


def test_what_was_not_judged_cannot_be_compared(tmp_path):
    with pytest.raises(UserError, match=r"there is no .*figures\.json; run `anystyle benchmark judge .*` first"):
        main([str(tmp_path), "noise", "pasted"])


def test_methods_without_a_common_cell_cannot_be_compared(figures):
    cells = [cell for cell in figures.cells if cell.method != "noise" or cell.scene == "scene0"]
    cells = [cell for cell in cells if cell.method != "pasted" or cell.scene == "scene1"]
    apart = msgspec.structs.replace(figures, cells=cells, scenes=[])
    with pytest.raises(UserError, match="noise and pasted have no figure in the same cell"):
        compare(apart, ["unstyled", "noise", "pasted"])
