"""A judged table is made again: equal, or what differs and what has changed."""

import re
import shutil

import pytest

from anystyle.io.atomic import write_json
from anystyle.io.documents import read_json
from anystyle_benchmark.command_judge import main as judge
from anystyle_benchmark.command_run import main as run
from anystyle_benchmark.command_verify import main
from tests.support.benchmark_world import write_track

PROGRAM = """
import sys
from anystyle_benchmark.job import Job
import numpy, msgspec, pathlib
from PIL import Image
job = msgspec.json.decode(pathlib.Path(sys.argv[1]).read_bytes(), type=Job)
for style in job.styles:
    folder = pathlib.Path(job.out) / style.name
    folder.mkdir(parents=True)
    for view in job.views:
        noise = numpy.random.default_rng([*style.name.encode(), *view.encode()]).integers(0, 64, (*job.size, 3))
        photograph = numpy.asarray(Image.open(job.photographs[view]).convert("RGB").resize(job.size[::-1]))
        Image.fromarray((photograph // 2 + noise).astype("uint8")).save(folder / f"{view}.png")
(pathlib.Path(job.out) / "weights.json").write_text('{"net.pt": "0123"}')
"""
SPEC = """
name = "noisy"
title = "Noisy"
command = ["{python}", "{here}/noisy.py", "{job}"]
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A track's file, a method's file and judged results of two scenes in three styles."""
    root = tmp_path_factory.mktemp("world")
    metrics = {"image": ("color_match", "style_retrieval", "sharpness")}
    track = write_track(root / "track", scenes=2, views=2, images=3, texts=0, metrics=metrics)
    (root / "noisy.toml").write_text(SPEC)
    (root / "noisy.py").write_text(PROGRAM)
    run([f"track={track}", f"methods=[{root / 'noisy.toml'}]", f"out={root / 'results'}"])
    judge([str(root / "results"), "--track", str(track), "--processes", "1"])
    return root


def verify(root, *words, figures="results"):
    options = ["--track", str(root / "track/track.toml"), "--method", f"noisy={root / 'noisy.toml'}"]
    main([str(root / figures), *options, *words])


@pytest.fixture
def copy(results, tmp_path):
    shutil.copytree(results, tmp_path / "world")
    return tmp_path / "world"


def test_a_cell_is_made_again_and_equal(results, capsys):
    verify(results, "--cell", "noisy/0/scene1/image2")
    said = capsys.readouterr().out
    assert "noisy/0/scene1/image2: all 4 figures are equal; " in said
    assert "1 of 1 cells hold" in said


def test_a_table_alone_is_made_again_without_its_images(results, tmp_path, capsys):
    """Retrieval compares a cell with the scene's other styles, which are made, too."""
    shutil.copy(results / "results/figures.json", tmp_path)
    options = ["--track", str(results / "track/track.toml"), "--method", f"noisy={results / 'noisy.toml'}"]
    main([str(tmp_path / "figures.json"), "--all", *options])
    assert capsys.readouterr().out.count("all 4 figures are equal") == 6


def test_what_differs_and_what_has_changed_is_told(copy, capsys):
    changed = (copy / "noisy.py").read_text().replace("// 2", "// 4").replace('"0123"', '"4567"')
    (copy / "noisy.py").write_text(changed)
    with pytest.raises(SystemExit) as ended:
        verify(copy, "--cell", "noisy/0/scene0/image0")
    said = capsys.readouterr().out
    assert ended.value.code == 2 and "0 of 1 cells hold" in said
    assert re.search(r"(color_match|sharpness) is \S+ and was \S+; changed: images, ", said)
    assert "weights net.pt 0123 -> 4567" in said


def test_cheap_compares_hashes_alone(copy, capsys):
    figures = read_json(copy / "results/figures.json", dict)
    (key,) = figures["origins"]
    figures["origins"][key] |= {"versions": {**figures["origins"][key]["versions"], "torch": "1.0"}, "weights": {}}
    figures["track"]["hashes"]["styles/image0.png"] = "0" * 64
    write_json(copy / "results/figures.json", figures)
    spec = (copy / "noisy.toml").read_text()
    (copy / "noisy.toml").write_text(spec.replace("{job}", "{job} fast"))
    with pytest.raises(SystemExit):
        verify(copy, "--all", "--cheap")
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 7 and said[-1] == "0 of 6 cells hold"
    assert all(
        " library torch 1.0 -> 2." in line and "input styles/image0.png 000000000000 -> " in line for line in said[:-1]
    )
    assert all("method's command" in line for line in said[:-1])


def test_a_method_that_is_not_at_hand(results, capsys):
    with pytest.raises(SystemExit):
        main([str(results / "results"), "--track", str(results / "track/track.toml"), "--cheap"])
    assert "cannot be made again: no method is named 'noisy'" in capsys.readouterr().out
