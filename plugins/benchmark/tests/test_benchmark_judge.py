"""The judge puts figures where they belong, keeps them, and loses nothing to bad images."""

import shutil

import msgspec
import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle.types import Comparison, Style
from anystyle_benchmark import judge as judging
from anystyle_benchmark.command_judge import main
from anystyle_benchmark.results import Cell, Figures, Record
from anystyle_benchmark.track import Inputs
from tests.support.benchmark_world import write_cell


@pytest.fixture
def copy(world, tmp_path):
    track, results = world
    shutil.copytree(results, tmp_path / "results")
    return track, tmp_path / "results"


def read(results):
    return msgspec.json.decode((results / "figures.json").read_bytes(), type=Figures)


def test_figures_are_of_cells_of_scenes_and_of_methods(world):
    figures = read(world[1])
    assert len(figures.cells) == (2 + 1 + 1) * 3 * 4  # methods with their seeds, scenes, styles
    by_image = [cell for cell in figures.cells if cell.guide == "image"]
    assert {cell.figures["style_retrieval"] for cell in by_image} == {0.0, 1.0}
    assert all(cell.figures["style_retrieval"] == 1 for cell in by_image if cell.method == "pasted")
    assert not any("kid" in cell.figures for cell in figures.cells)
    assert [len(scene.figures) for scene in figures.scenes] == [1] * 12  # KID is a distance of all styles of a scene
    means = {(row.method, row.guide): row.figures for row in figures.table}
    noise = [cell.figures["color_match"] for cell in by_image if cell.method == "noise"]
    assert means["noise", "image"]["color_match"].mean == pytest.approx(np.mean(noise), rel=1e-6)
    assert means["noise", "image"]["color_match"].n == 9  # seeds are no further scenes or styles
    assert means["noise", "image"]["kid"].n == 3
    pasted, unstyled, noisy = (means[name, "image"] for name in ("pasted", "unstyled", "noise"))
    assert pasted["color_match"].mean < unstyled["color_match"].mean
    assert unstyled["warp_rmse_short"].mean < 0.01 < pasted["warp_rmse_short"].mean < noisy["warp_rmse_short"].mean
    by_text = means["noise", "text"].keys()
    assert {"clip_style", "warp_rmse_short"} <= by_text and "color_match" not in by_text
    assert figures.metrics["clip_style"].stand_in == "tiny"  # no CLIP is installed here
    assert figures.metrics["kid"].stand_in and figures.metrics["kid"].better == "lower"
    assert "Bińkowski" in figures.metrics["kid"].reference


def test_a_cell_is_what_the_metric_says_of_its_images(world):
    track, results = world
    inputs = Inputs(str(track))
    scene, style = inputs.track.scenes[1], inputs.style("image2")

    def tensor(image):
        return torch.from_numpy(np.array(image)).permute(2, 0, 1).float() / 255

    files, lanczos = inputs.photographs(scene), Image.Resampling.LANCZOS
    content = torch.stack([tensor(Image.open(files[view]).resize((64, 48), lanczos)) for view in scene.views])
    folder = results / "noise" / "1" / scene.name / "image2"
    shown = torch.stack([tensor(Image.open(folder / f"{view}.png")) for view in scene.views])
    reference = Style(image=tensor(Image.open(inputs.path(style.image)))[None])
    comparison = Comparison(content=content[None], stylized=shown[None], style=reference)
    target = Cell("noise", 1, scene.name, "image2")
    (cell,) = [cell for cell in read(results).cells if cell.cell == target]
    (metric,) = judging.make(["color_match"], []).values()
    metric.update(comparison)
    assert cell.figures["color_match"] == pytest.approx(float(metric.compute()), rel=1e-5)


def test_two_runs_are_equal_to_the_last_byte_and_only_what_changed_is_judged(copy, monkeypatch):
    track, results = copy
    before = (results / "figures.json").read_bytes()
    seen = []

    def counted(metrics, comparisons, on_error):
        rows = list(comparisons)
        seen.append((rows[0].scenes[0], [row.styles[0] for row in rows], sorted(metrics)))
        return original(metrics, rows, on_error)

    original = judging.loop.judge_scene
    monkeypatch.setattr(judging.loop, "judge_scene", counted)
    main([str(results), "--track", str(track), "--processes", "1"])
    assert (results / "figures.json").read_bytes() == before
    # Of a scene without geometry, what could not be said is asked again.
    assert all(metrics == ["warp_consistency"] and scene == "scene2" for scene, _, metrics in seen)
    seen.clear()
    write_cell(Inputs(str(track)), results, Cell("palette", 0, "scene0", "image1"))
    shutil.rmtree(results / "noise" / "0" / "scene0" / "image1")
    (results / "palette" / "0" / "scene0" / "image1").rename(results / "noise" / "0" / "scene0" / "image1")
    shutil.rmtree(results / "palette")
    main([str(results), "--track", str(track), "--metrics", "color_match,kid", "--processes", "1"])
    assert seen == [("scene0", ["image0", "image1", "image2"], ["color_match", "kid"])]
    assert str(results.parent).encode() not in (results / "figures.json").read_bytes() != before


@pytest.mark.slow
def test_several_processes_write_what_one_does(copy):
    track, results = copy
    texts = []
    for processes in ("1", "2"):
        shutil.rmtree(results / ".judged")
        main([str(results), "--track", str(track), "--metrics", "style_retrieval", "--processes", processes])
        texts.append((results / "figures.json").read_bytes())
    assert texts[0] == texts[1]


def test_bad_images_are_failures_of_their_cells_alone(copy, capsys):
    track, results = copy
    before = {cell.cell: cell for cell in read(results).cells}
    scene = results / "pasted" / "0" / "scene1"
    (scene / "image0" / "001.png").unlink()
    Image.new("RGB", (10, 10)).save(scene / "image1" / "001.png")
    (scene / "text0" / "000.png").write_text("no image")
    other = results / "unstyled" / "0" / "scene0"
    (other / "image2.json").unlink()
    write_json(other / "image1.json", msgspec.to_builtins(Record("timeout", "was stopped after 2 hours")))
    capsys.readouterr()
    main([str(results), "--track", str(track), "--processes", "1"])
    lines = capsys.readouterr()
    cells = {cell.cell: cell for cell in read(results).cells}
    bad = {key: (cell.status, cell.message) for key, cell in cells.items() if cell.status != "done"}
    assert bad.pop(("unstyled", 0, "scene0", "image2")) == ("missing", "")
    assert bad.pop(("unstyled", 0, "scene0", "image1")) == ("timeout", "was stopped after 2 hours")
    assert {key[2:]: message for key, (_, message) in bad.items()} == {
        ("scene1", "image0"): "there is no image0/001.png",
        ("scene1", "image1"): "image1/001.png is 10x10; 64x48 is expected",
        ("scene1", "text0"): bad["pasted", 0, "scene1", "text0"][1],
    }
    assert "is not a readable image" in bad["pasted", 0, "scene1", "text0"][1]
    assert "failed: pasted, 0, scene1, image1: image1/001.png is 10x10" in lines.err
    assert "7 of 9" in lines.out
    for key, cell in cells.items():
        if cell.status == "done":
            own = ("color_match", "warp_rmse_short")
            assert [cell.figures.get(name) for name in own] == [before[key].figures.get(name) for name in own]
        else:
            assert cell.figures == {}


def test_methods_that_were_judged_elsewhere_are_shown_beside_as_if_judged_together(copy, capsys, monkeypatch):
    track, results = copy
    whole, alone, words = read(results), results.parent / "alone", ["--track", str(track), "--processes", "1"]
    shutil.copytree(results / "pasted", alone / "pasted")
    main([str(alone), *words, "--beside", str(results)])
    assert "Noise" in capsys.readouterr().out
    found = read(alone)
    for name in ("track", "metrics", "methods", "origins"):
        assert getattr(found, name) == getattr(whole, name)
    for name in ("cells", "scenes", "table"):
        rows = [sorted(map(repr, getattr(one, name))) for one in (found, whole)]
        assert rows[0] == rows[1]
    others = msgspec.structs.replace(whole.metrics["kid"], weights={"network.bin": "0"})
    monkeypatch.setattr(judging.Judge, "__call__", lambda *args: pytest.fail("judged in vain"))
    changes = {"metrics": whole.metrics | {"kid": others}}, {"track": msgspec.structs.replace(whole.track, digest="0")}
    for change, message in zip(changes, ("other networks computed kid", "its inputs differ"), strict=True):
        write_json(results / "figures.json", msgspec.to_builtins(msgspec.structs.replace(whole, **change)))
        with pytest.raises(UserError, match=f"cannot be shown beside {alone}: .*{message}"):
            main([str(alone), *words, "--beside", str(results / "figures.json")])


def test_somebodys_folder_is_checked_without_judging(world, tmp_path, capsys):
    track, results = world
    folder = shutil.copytree(results / "noise" / "0", tmp_path / "images")
    words = ["--check", str(folder), "--track", str(track)]
    main(words)
    assert "every image" in capsys.readouterr().out
    for scene in ("scene0", "scene1", "scene2"):
        shutil.rmtree(folder / scene / "text0")
    main(words)  # a method that follows images alone
    capsys.readouterr()
    shutil.rmtree(folder / "scene1" / "image1")
    (folder / "scene2" / "image0" / "001.png").write_bytes(b"\x89PNG")
    (folder / "attic" / "image0").mkdir(parents=True)
    with pytest.raises(UserError, match=r"3 things are wrong with .*images"):
        main(words)
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["attic: the track has no such scene", "scene1: there is no image1"]
    assert lines[2].startswith("scene2: image0/001.png is not a readable image")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "name the folder of results"),
        (["--check", "DIR"], "--check needs --track"),
        (["--check", "DIR/none", "--track", "TRACK"], "there is no folder"),
        (["DIR/none", "--track", "TRACK"], "holds no results of a method"),
        (["RESULTS", "--track", "TRACK", "--metrics", "kidd"], "Did you mean 'kid'"),
        (["RESULTS", "--track", "OTHER"], "it is of track small 1, judge 1, not of track small 2, judge 1"),
        (["RESULTS"], r"of track small, which is a file of yours; name it: --track FILE\.toml"),
    ],
)
def test_slips_are_one_line(world, tmp_path, words, message):
    track, results = world
    other = tmp_path / "other"
    if "OTHER" in words:
        shutil.copytree(track.parent, other)
        (other / "track.toml").write_text(track.read_text().replace("version = 1", "version = 2"))
    places = {"TRACK": str(track), "RESULTS": str(results), "DIR": str(tmp_path), "OTHER": str(other / "track.toml")}
    with pytest.raises(UserError, match=message):
        main([places.get(word, word.replace("DIR", str(tmp_path))) for word in words])
