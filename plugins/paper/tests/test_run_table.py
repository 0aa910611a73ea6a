"""Runs side by side: what became of each job, seeds and intervals, stand-ins and published rows kept apart."""

import hashlib
import json

import numpy as np
import pytest
from scipy import stats

from anystyle.contracts.protocol import Evaluation
from anystyle.evaluation import record
from anystyle.evaluation.tables import STAND_IN, Table
from anystyle_paper import latex, runs
from anystyle_paper import published_scores as published
from anystyle_paper import run_table as report
from tests.support.pictures import picture


def evaluation(folder, scores, *, n=4, groups=None, stand_ins=None, better=None, **provenance):
    folder.mkdir(parents=True, exist_ok=True)
    found = Evaluation(scores, n, better=better or {}, groups=groups or {}, stand_ins=stand_ins or {})
    record.write(found, folder, {"protocol": "paper", **provenance})
    return folder


def job(folder, *words, scores=None, logged=None, **more):
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "overrides.yaml").write_text("".join(f"- {word}\n" for word in words) or "[]\n")
    if logged is not None:
        (folder / "metrics.json").write_text(json.dumps(logged))
    if scores is not None:
        evaluation(folder / "evaluation", scores, **more)
    return folder


@pytest.fixture
def sweep(tmp_path):
    root = tmp_path / "sweep"
    job(root / "0", "ablation=base", "experiment=tiny", scores={"art_fid": 20.0}, better={"art_fid": "lower"})
    job(root / "1", "ablation=no_text", "experiment=tiny", scores={"art_fid": 25.0}, n=2)
    job(root / "2", "ablation=no_style_loss", "experiment=tiny")
    job(root / "10", "ablation=all_geometry", "experiment=tiny")
    (root / "10" / "last.ckpt").write_bytes(b"half")
    return root


def test_a_row_is_named_by_its_word_or_by_its_value_where_that_is_a_name(tmp_path):
    words = ("ablation=base", "without=[mine]", "loss=[mine]", "~loss.mine", "rate=0.1", "average=null", "half=true")
    for index, word in enumerate(words):
        job(tmp_path / str(index), word, "experiment=tiny", scores={"psnr": 1.0})
    assert [line.title for line in report.lines_of(runs.find(tmp_path))[0]] == ["base", *words[1:]]


def test_jobs_in_order_with_what_became_of_them(sweep):
    found = runs.find(sweep)
    states = {"0": "finished", "1": "finished", "2": "failed", "10": "unfinished"}
    assert [(run.folder.name, run.state) for run in found] == list(states.items())
    lines, better = report.lines_of(found)
    made = report.table(lines, [("", "art_fid")], better)
    assert made.columns == ("variant", "source", "art_fid ↓")
    assert [row[::2] for row in made.rows] == [
        ("base", "20"), ("no_text", "25"), ("no_style_loss", "–"), ("all_geometry", "–")
    ]  # fmt: skip
    assert "Behind the rows are different numbers of samples: base 4, no_text 2." in report.state_notes(lines)


def test_jobs_that_left_nothing_are_missing(sweep):
    (sweep / "multirun.yaml").write_text(
        "hydra: {overrides: {task: ['ablation=base,no_text,no_style_loss,all_geometry', 'experiment=tiny']}}\n"
    )
    found = runs.find(sweep)
    assert [(run.folder.name, run.state, run.words[0]) for run in found] == [
        ("0", "finished", "ablation=base"),
        ("1", "finished", "ablation=no_text"),
        ("2", "failed", "ablation=no_style_loss"),
        ("3", "missing", "ablation=all_geometry"),
        ("10", "unfinished", "ablation=all_geometry"),
    ]
    (sweep / "multirun.yaml").write_text("hydra: {overrides: {task: ['ablation=base,all,no_text', experiment=tiny]}}\n")
    found = [(run.folder.name, run.state, run.words[0][9:]) for run in runs.find(sweep)]
    # In the folder of the last command's second job lies another's.
    assert found[:3] == [("0", "finished", "base"), ("1", "missing", "all"), ("1", "finished", "no_text")]


def test_jobs_that_are_named_by_their_words_are_found_also_where_these_have_a_slash(tmp_path):
    (tmp_path / "multirun.yaml").write_text(
        "hydra: {overrides: {task: ['scenes.root=in/a,b', 'seed=0,1', fast_dev_run=false]}}\n"
    )
    for name, words in {"scenes.root=in/a,seed=0": "in/a 0", "scenes.root=b,seed=0": "b 0"}.items():
        root, seed = words.split()
        job(tmp_path / name, f"scenes.root={root}", f"seed={seed}", "fast_dev_run=False", scores={"art_fid": 20.0})
    found = {(run.state, *run.words[:2]) for run in runs.find(tmp_path)}
    finished = {("finished", f"scenes.root={root}", "seed=0") for root in ("in/a", "b")}
    assert found == finished | {("missing", f"scenes.root={root}", "seed=1") for root in ("in/a", "b")}


def test_seeds_of_one_variant_are_one_row_with_an_interval(tmp_path):
    values = {"base": (10.0, 12.0, 14.5), "no_text": (20.0, 21.0, 19.0)}
    for v, (name, some) in enumerate(values.items()):
        for s, value in enumerate(some):
            job(tmp_path / str(3 * v + s), f"ablation={name}", f"seed={s}", scores={"art_fid": value})
    lines, better = report.lines_of(runs.find(tmp_path))
    assert [line.title for line in lines] == ["base", "no_text"]
    low, high = stats.t.interval(0.95, 2, loc=np.mean(values["base"]), scale=stats.sem(values["base"]))
    assert lines[0].half_width(("", "art_fid")) == pytest.approx((high - low) / 2)
    assert report.table(lines, [("", "art_fid")], better).rows[0][2] == f"12.17 ± {(high - low) / 2:.4g}"
    assert "3 seeds" in report.state_notes(lines)[-1]
    (row, _), names = report.data(lines, [("", "art_fid")]).rows, report.data(lines, [("", "art_fid")]).columns
    assert names == ("variant", "source", "art_fid", "art_fid_half_width", "n") and row[4] == "3"
    assert (float(row[2]), float(row[3])) == (sum(values["base"]) / 3, lines[0].half_width(("", "art_fid")))


def test_the_points_and_signs_of_a_column_of_latex_stand_below_each_other():
    cells = ["12.17 ± 5.7", "233 ± 144.25", "0.9 (1st)", "-3.5", "–", "2.15e-05"]
    text = latex.aligned(Table(("variant", "art_fid ↓"), tuple((f"a & {cell}", cell) for cell in cells)))
    assert text.splitlines()[0].startswith("% Needs \\usepackage{booktabs}") and "{lr}" in text
    assert [line.split(" & ", 1)[1] for line in text.splitlines() if line.startswith("a \\& ")] == [
        r"12.17 $\pm$ \phantom{00}5.7\phantom{0} \\",
        r"233\phantom{.00} $\pm$ 144.25 \\",
        r"\textbf{0.9}\phantom{0}\phantom{ $\pm$ 000.00} \\",
        r"$-$3.5\phantom{0}\phantom{ $\pm$ 000.00} \\",
        r"-- \\",
        r"$2.15 \times 10^{-5}$ \\",
    ]


def test_scores_of_stand_ins_are_rows_of_their_own(tmp_path):
    folder = evaluation(tmp_path / "run", {"art_fid": 300.0, "psnr": 20.0}, stand_ins={"art_fid": "texture"})
    lines, _ = report.lines_of(runs.find(folder))
    assert [(line.source, sorted(name for _, name in line.samples)) for line in lines] == [
        ("computed here", ["psnr"]), (STAND_IN, ["art_fid"])
    ]  # fmt: skip
    lines += report.published_lines(published.load())[0]
    for row in report.table(lines, report.columns_of(lines, ["art_fid", "psnr"], ["", "Train"]), {}).rows:
        kinds = {"300": STAND_IN, "20": "computed here", "27.74": "published [1]"}
        assert all(row[1] == said for value, said in kinds.items() if value in row[2:])


def test_published_scores_are_sourced():
    scores = published.load()
    assert all(item.source and item.table and np.isfinite(item.value) for item in scores)
    directed = published.better()
    assert all(item.score in directed for item in scores if item.table != "table_1")


def test_files_of_published_scores_that_cannot_be_read(tmp_path):
    path, told = tmp_path / "mine.json", r"mine\.json is not a valid file of published scores.* as in published\.json"
    for text in ("[]", "{", '{"sources": {}, "rows": [{"method": "a"}]}'):
        path.write_text(text)
        with pytest.raises(ValueError, match=told):
            published.load([path])


def test_scenes_are_columns_in_the_order_of_the_paper(tmp_path):
    groups = {f"scene {name}": {"art_score": 9.0 + i, "art_fid": 20.0 + i} for i, name in enumerate(("Train", "M60"))}
    folder = evaluation(tmp_path / "run", {"art_fid": 20.5, "art_score": 9.5, "lpips": 0.4}, groups=groups)
    lines, _ = report.lines_of(runs.find(folder))
    assert report.scores_of(lines) == ["art_score", "art_fid", "lpips"]
    scenes = report.scenes_of(lines, ["art_score", "art_fid"])
    columns = report.columns_of(lines, ["art_score", "art_fid"], scenes)
    made = report.table(lines, columns, published.better())
    assert made.columns[2:] == ("Train art_score ↑", "Train art_fid ↓", "M60 art_score ↑", "M60 art_fid ↓")
    assert made.rows[0][2:] == ("9", "20", "10", "21")
    with pytest.raises(ValueError, match="no run has the score 'nothing'; there are art_fid, art_score, lpips"):
        report.scores_of(lines, ["nothing"])


def test_one_scene_stands_beside_the_published_one_of_its_name(tmp_path):
    found = Evaluation({"art_fid": 33.0}, 4, provenance={"scenes": ["train"]})
    record.write(found, tmp_path, {"protocol": "paper"})
    lines, _ = report.lines_of(runs.find(tmp_path))
    lines += report.published_lines(published.load())[0]
    scenes = report.scenes_of(lines, ["art_fid"])
    made = report.table(lines, report.columns_of(lines, ["art_fid"], scenes), {})
    column = made.columns.index("Train art_fid")
    cells = {(row[0], row[1]): row[column] for row in made.rows}
    assert cells[tmp_path.name, "computed here"] == "33" and cells["Styl3R", "published [1]"] == "27.74"
    assert cells["AnyStyle (image), Agg", "published [1]"] == "22.86 (1st)"  # table_2 leaves the variant out


def test_trainings_are_reported_by_what_they_logged(tmp_path):
    job(tmp_path / "run", logged={"train/loss": 0.5, "val/psnr": None})
    (line,) = report.lines_of(runs.find(tmp_path / "run"))[0]
    assert line.title == "run" and line.value("", "train/loss") == 0.5


def test_scores_of_weights_that_were_trained_anew_are_no_row(tmp_path, caplog):
    judged = {"branch": {"sha256": hashlib.sha256(b"first").hexdigest()}, "style_encoder": None}
    run = job(tmp_path / "run", "a=1", logged={"train/loss": 0.5}, scores={"psnr": 20.0}, weights=judged)
    (run / "last.ckpt").write_bytes(b"state")
    for weights, told in ((b"first", 0), (b"second", 1)):
        (run / "branch.safetensors").write_bytes(weights)
        (line,) = report.lines_of(runs.find(run))[0]
        assert ("psnr" in {name for _, name in line.samples}) == (not told) and len(caplog.messages) == told
    assert caplog.messages == [f"{run / 'evaluation'} judged other weights than {run} has now: evaluate it again"]
    (run / "metrics.json").unlink()  # as a training does when it begins
    assert [found.state for found in runs.find(run)] == ["unfinished"]


def test_the_table_says_whether_its_rows_are_of_one_version(tmp_path):
    for name in ("first", "second"):
        evaluation(tmp_path / name, {"psnr": 20.0}, commit="a" * 40, versions={"anystyle": "1"})
    notes = report.state_notes(report.lines_of(runs.find(tmp_path))[0])
    assert notes == ["All scores computed here are of anystyle 1, commit aaaaaaaaaaaa."]
    evaluation(tmp_path / "second", {"psnr": 20.0}, commit="b" * 40, versions={"anystyle": "1"})
    (note,) = report.state_notes(report.lines_of(runs.find(tmp_path))[0])
    assert note.startswith("Rows are of 2 versions. anystyle 1, commit aaaaaaaaaaaa: first; ")


def test_the_sheet_has_a_row_for_each_variant_and_a_column_for_each_style(sweep):
    for number, shade in ((0, 10), (1, 90)):
        images = sweep / str(number) / "evaluation" / "images"
        for style in ("00", "01"):
            for frame in range(3):
                picture(images / "stylized" / "train" / f"{style}_{frame:03d}.png", shade + frame)
            picture(images / "style" / f"{style}.png", 200)
    lines, _ = report.lines_of(runs.find(sweep))
    rows, titles, columns = report.sheet_cells(lines)
    assert titles == ["style", "base", "no_text", "no_style_loss", "all_geometry"]
    assert columns == ["style 00", "style 01"]
    assert [cell.getpixel((0, 0))[0] for cell in (rows[0][0], rows[1][0], rows[2][1])] == [200, 11, 91]
    assert [cell.text for cell in (rows[3][0], rows[4][1])] == ["failed", "unfinished"]
    assert report.sheet_cells(lines[2:]) is None
