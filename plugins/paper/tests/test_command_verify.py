"""`anystyle report verify`: scores made again, and what has changed where they cannot be."""

import json
import shutil
from pathlib import Path

import pytest

from anystyle.commands import evaluate
from anystyle.errors import UserError
from anystyle.evaluation import provenance
from anystyle_paper import command, command_verify, verify
from anystyle_paper.runs import find
from tests.support.evaluation_cases import folders, picture

METRICS = "metric=[psnr,timing]"


@pytest.fixture
def evaluated(tmp_path, monkeypatch):
    """An evaluation of folders with relative paths, and a copy of it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(verify, "commit", lambda: "a" * 40)
    monkeypatch.setattr("anystyle.evaluation.run.commit", lambda: "a" * 40)
    folders(tmp_path / "in")
    given = ["--content", "in/content", "--style", "in/style", "--stylized", "in/stylized", METRICS]
    evaluate.main([*given, "--out", "runs/first"])
    shutil.copytree("runs/first", "runs/second")
    return tmp_path / "runs"


def verified(capsys, folder: Path, *words: str) -> tuple[int, list[str]]:
    capsys.readouterr()
    status = command_verify.main([str(folder), *words])
    return status, capsys.readouterr().out.splitlines()


def edit(folder: Path, change) -> None:
    stored = json.loads((folder / "metrics.json").read_text())
    change(stored)
    (folder / "metrics.json").write_text(json.dumps(stored))


def test_all_is_made_again_from_anywhere_and_times_are_not_compared(evaluated, capsys, monkeypatch):
    edit(evaluated / "first", lambda stored: stored.update(psnr=stored["psnr"] * (1 + 1e-7)))
    monkeypatch.chdir(evaluated.parents[1])
    status, lines = verified(capsys, evaluated, "--all")
    kept = "nothing it rests on has changed"
    assert status == 0 and lines[2:] == ["2 of 2 evaluations hold"]
    assert (
        lines[0]
        == f"{evaluated / 'first'}: all 3 scores are equal within rounding, psnr by 1.0e-07 of its value; {kept}"
    )
    assert lines[1] == f"{evaluated / 'second'}: all 3 scores are equal; {kept}"


def test_another_score_is_told_with_what_has_changed(evaluated, capsys):
    picture(Path("in/stylized/one/a_1.png"), 250)
    edit(evaluated / "second", lambda stored: stored["provenance"]["versions"].update(torch="1.0"))
    status, lines = verified(capsys, evaluated, "--row", "second", "--out", "kept")
    assert status == 2 and lines[-1] == "0 of 1 evaluations hold"
    assert "psnr" in lines[0] and "and was" in lines[0] and "changed: library torch 1.0 -> " in lines[0]
    assert "input protocol.stylized " in lines[0] and "content" not in lines[0].replace("in/content", "")
    assert Path("kept/0/metrics.json").is_file()
    status, lines = verified(capsys, evaluated, "--row", "second", "--cheap")
    assert status == 2 and lines[0].startswith(f"{evaluated / 'second'}: changed: library torch 1.0 -> ")
    shutil.rmtree("in/stylized")
    status, lines = verified(capsys, evaluated, "--row", "first")
    assert status == 2 and "cannot be made again: there is no stylized folder" in lines[0]
    assert "changed: input protocol.stylized" in lines[0] and "-> missing" in lines[0]


def test_a_row_is_drawn_at_random_or_named(evaluated, capsys):
    status, lines = verified(capsys, evaluated, "--cheap")
    assert status == 0 and lines[-1] == "1 of 1 evaluations hold"
    with pytest.raises(UserError, match="there are first, second"):
        command_verify.main([str(evaluated), "--row", "third"])


def test_nothing_is_taken_for_granted(evaluated, capsys):
    """An older record without checksums, a folder that holds earlier scores, and runs that were never judged."""
    Path("kept").mkdir()
    with pytest.raises(UserError, match="kept exists; scores are made again in a folder that does not"):
        command_verify.main([str(evaluated), "--all", "--out", "kept"])
    edit(evaluated / "first", lambda stored: stored["provenance"].pop("inputs"))
    with pytest.raises(UserError, match="holds no evaluation with its configuration and checksums of inputs"):
        command_verify.main([str(evaluated), "--row", "first", "--cheap"])
    logged = Path("trained/0/.hydra")
    logged.mkdir(parents=True)
    (logged / "overrides.yaml").write_text("[seed=0]")
    (logged.parent / "metrics.json").write_text('{"train/loss": 0.5}')
    with pytest.raises(UserError, match="there are no evaluations, only trainings"):
        command_verify.main(["trained", "--all"])
    command_verify.main([str(evaluated / "second"), "trained", "--all", "--cheap"])
    assert "without an evaluation, and not verified: trained/0" in capsys.readouterr().err


def test_what_an_evaluation_did_not_rest_on_before_is_told():
    assert verify.changes({"code": "a"}, {"code": "a", "weights metric x (f)": "1"}) == (
        "weights metric x (f) missing -> 1",
    )


def test_results_inside_of_an_input_are_no_part_of_it(evaluated):
    before = provenance.digest(Path("in/stylized"))
    shutil.copytree(evaluated / "first", "in/stylized/evaluation")
    assert provenance.digest(Path("in/stylized")) == before
    Path("in/stylized/one/more.png").write_bytes(b"")
    assert provenance.digest(Path("in/stylized")) != before


def test_code_with_uncommitted_changes_is_never_the_same():
    assert verify.changes({"code": "abc+"}, {"code": "abc+"}) == ("code (uncommitted changes)",)
    assert verify.changes({"code": "abc"}, {"code": "abc"}) == ()


def test_the_table_says_whether_its_rows_are_of_one_version(evaluated, capsys):
    command.Report()([str(evaluated)])
    assert "All scores computed here are of anystyle " in capsys.readouterr().out
    edit(evaluated / "second", lambda stored: stored["provenance"].update(commit="b" * 40))
    command.Report()([str(evaluated)])
    told = capsys.readouterr().out
    assert "Rows are of 2 versions. anystyle " in told and "commit aaaaaaaaaaaa: first; " in told


def test_inputs_are_hashes_of_the_files_that_options_name(tmp_path, monkeypatch):
    content, *_ = folders(tmp_path / "in")
    config = {"protocol": {"content": str(content), "missing": "refuse", "depth": None}, "out": str(tmp_path)}
    found = provenance.foundations(config)["inputs"]
    first = found["protocol.content"]
    assert list(found) == ["protocol.content"]
    shutil.copytree(content, tmp_path / "copy")
    assert provenance.digest(tmp_path / "copy") == first and len(first) == 64
    monkeypatch.setattr(provenance, "MOST_BYTES", 10)
    assert provenance.digest(content).startswith("sizes ")


def test_several_evaluations_in_one_folder_are_a_row_each(evaluated):
    assert [run.folder.name for run in find(evaluated)] == ["first", "second"]
