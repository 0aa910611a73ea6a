"""Stylizing as a library call."""

import json
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

import anystyle
from anystyle import Controls, ExportOptions, Mixture, Named, PoseOptions, ViewOptions
from anystyle.commands import stylize
from anystyle.contracts import SceneSource
from anystyle.data.folder import read_views
from anystyle.pipeline.results import Restyler
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import embed_styles, slug
from anystyle.pipeline.words import args_of, request
from anystyle.types import Gaussians, Style

VIEWS = ViewOptions(short_side=56, take=3)
VIDEO = {"frames": 2, "scale": 0.5}


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load()


def test_a_result_is_the_single_pass_announced_stage_by_stage(photographs, stylizer):
    announced = []
    stages = Stages(lambda stage, progress: announced.append((stage, progress.line)))
    state = torch.random.get_rng_state()
    (result,) = anystyle.stylize(photographs, "red dots", model=stylizer, views=VIEWS, stages=stages)
    assert [name for name, _ in announced] == ["load", "embed", "read", "encode", "restyle"] == list(stages.seconds)
    assert announced[3:] == [("encode", "3 views of 70x56"), ("restyle", "1/1: “red dots”")]
    views, sources = read_views([photographs], short_side=56, multiple=stylizer.backbone.patch_size, max_views=3)
    with torch.no_grad():
        expected: Gaussians = stylizer(views, stylizer.embed(text="red dots"))
    for name in ("means", "rotations", "scales", "opacities", "harmonics"):
        assert torch.equal(getattr(result.gaussians, name), getattr(expected, name)), name
    assert list(result.encoded.sources) == sources
    assert torch.equal(torch.random.get_rng_state(), state)  # the caller's random numbers go on
    rendered = torch.stack(list(result.render()))
    torch.testing.assert_close(rendered, stylizer.render(expected, result.cameras).color[0])
    assert [image.shape for image in result.render(result.cameras.select([1]))] == [(3, *views.size)]


def interrupted_at(name):
    """A call of a restyler that somebody ends when it comes to a style."""
    styled = Restyler.__call__

    def call(self, style, on_progress):
        if style.name == name:
            raise KeyboardInterrupt
        return styled(self, style, on_progress)

    return call


def test_a_film_that_is_not_needed_any_more_is_not_finished(photographs, stylizer, tmp_path, monkeypatch):
    monkeypatch.setattr(Restyler, "__call__", interrupted_at("waves"))
    long = {"frames": 100_000, "scale": 0.5}  # minutes
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        anystyle.stylize(photographs, ["dots", "waves"], model=stylizer, views=VIEWS, video=long, out=tmp_path / "out")
    assert time.perf_counter() - start < 30
    assert not (tmp_path / "out").exists()


def test_styles_that_are_finished_stay_where_a_later_one_is_interrupted(
    photographs, stylizer, tmp_path, monkeypatch, caplog
):
    out, words = tmp_path / "out", ["dots", "waves", "rain"]
    options = {"model": "tiny", "views": VIEWS, "video": VIDEO}
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Restyler, "__call__", interrupted_at("rain"))
        anystyle.stylize(photographs, words, out=out, **options)
    folders = sorted(path.name for path in out.iterdir() if path.is_dir())
    assert folders in (["01-dots"], ["01-dots", "02-waves"])  # the film of the second may have been cut
    assert len(json.loads((out / "report.json").read_text())["style"]) == len(folders)
    assert f"{len(folders)} of 3 styles are in {out}; the same command makes all" in caplog.text
    (rest,) = anystyle.stylize(out, "rain", model="tiny", out=tmp_path / "rest", video=VIDEO)
    assert rest.encoded.reconstruction["kind"] == "given" and (tmp_path / "rest" / "scene.ply").is_file()
    anystyle.stylize(photographs, words, out=out, **options)
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == ["01-dots", "02-waves", "03-rain"]


def test_the_call_and_a_report_make_what_the_command_made(photographs, tmp_path, monkeypatch):
    monkeypatch.chdir(photographs.parent)  # a report names no folders above what it was given
    words = "--text dots --strength 0.5 views.short_side=56 views.take=2 video.frames=2 video.scale=0.5 seed=7"
    words = [photographs.name, *words.split(), "export.colmap=binary"]
    stylize.main([*words, "--out", str(tmp_path / "a")])
    options = {"views": replace(VIEWS, take=2), "export": ExportOptions(colmap="binary"), "seed": 7}
    anystyle.stylize(photographs.name, ["dots"], controls=Controls(0.5), video=VIDEO, out=tmp_path / "b", **options)
    stylize.main(["--again", str(tmp_path / "a" / "report.json"), "--out", str(tmp_path / "c")])
    files = [sorted(p.relative_to(tmp_path / name) for p in (tmp_path / name).rglob("*.*")) for name in "abc"]
    assert files[0] == files[1] == files[2] and Path("sparse/0/images.bin") in files[0]
    for file in {*files[0]} - {Path("report.json")}:
        assert len({(tmp_path / name / file).read_bytes() for name in "abc"}) == 1, file
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in "abc"]
    assert reports[0]["request"] == args_of(request(words))
    for report in reports:
        del report["seconds"], report["write_share"], report["reconstruction"]["seconds"]
    typed, made, again = (request(report.pop("request")) for report in reports)
    assert typed.config == made.config and typed.styles == made.styles and typed == again
    assert reports[0] == reports[1] == reports[2] and reports[0]["config"]["views"]["take"] == 2


def test_one_encoding_serves_all_styles_and_results_come_when_they_are_asked_for(photographs, stylizer, monkeypatch):
    calls = []
    for name in ("encode", "restyle"):
        call = getattr(stylizer, name)
        monkeypatch.setattr(stylizer, name, lambda *x, name=name, call=call, **y: calls.append(name) or call(*x, **y))
    results = anystyle.stylize(photographs, ["blue", "red", "green"], model=stylizer, views=VIEWS)
    assert len(results) == 3 and calls == ["encode"]
    assert results[-1].style.name == "green" and calls == ["encode", "restyle"]
    assert [result.style.name for result in results] == ["blue", "red", "green"] and calls.count("restyle") == 4
    with pytest.raises(IndexError):
        results[3]


def test_styles_are_texts_files_tensors_and_points_between(photographs, stylizer, tmp_path):
    Image.new("RGB", (40, 30), (200, 30, 30)).save(tmp_path / "Red Painting.png")
    image = torch.tensor([200, 30, 30])[:, None, None].expand(3, 30, 40) / 255
    file, text = tmp_path / "Red Painting.png", "blue ink"
    styles = [file, image, Style(image=image[None], names=("No. 4",)), Style(text=(text,)), text]
    styles += [Mixture(text, file, amount) for amount in (0.0, 0.25, 1.0)]
    results = anystyle.stylize(photographs, styles, model=stylizer, views=VIEWS)
    titles = ["Red Painting", "image", "No. 4", "“blue ink”", "“blue ink” 2"]
    assert [style.title for style in results.styles[:5]] == titles
    assert [style.name for style in results.styles[:3]] == ["red-painting", "image", "no-4"]
    assert results.styles[6].name == "blue-ink_0.25_red-painting"
    vectors = [style.embedding.vector for style in results.styles]
    for index in (1, 2, 7):
        torch.testing.assert_close(vectors[index], vectors[0], rtol=0, atol=1e-6)
    assert torch.equal(vectors[3], vectors[4]) and torch.equal(vectors[5], vectors[4])
    torch.testing.assert_close(vectors[6], torch.lerp(vectors[4], vectors[0], 0.25))
    assert [style.cell is None for style in results.styles] == [False] * 3 + [True] * 4 + [False]


def test_views_that_were_read_already_keep_their_known_cameras(stylizer):
    node = {"_target_": anystyle.catalog().find("scenes", "procedural").path, "size": 56}
    views = anystyle.build(SceneSource, node).read(0, range(3))
    predicted = anystyle.stylize(views, "dots", model=stylizer)
    targets = anystyle.stylize(views, "dots", model=stylizer, poses=PoseOptions("target")).encoded
    known = anystyle.stylize(views, "dots", model=stylizer, poses=PoseOptions("known")).encoded
    assert predicted.encoded.targets is None and predicted.encoded.scene_from_known is None
    assert targets.targets is not None and targets.targets[0] == ("view_00", "view_01", "view_02")
    assert torch.equal(targets.cameras.world_from_camera, predicted.encoded.cameras.world_from_camera)
    assert known.scene_from_known is not None
    expected = known.scene_from_known.poses(views.cameras.world_from_camera)
    torch.testing.assert_close(known.cameras.world_from_camera, expected)
    torch.testing.assert_close(targets.targets[1].world_from_camera, expected)
    with pytest.raises(ValueError, match="this source knows no cameras"):
        anystyle.stylize(replace(views, cameras=None), "dots", model=stylizer, poses=PoseOptions("known"))


def test_what_cannot_be_done_is_one_line_and_leaves_nothing(photographs, stylizer, tmp_path):
    out = tmp_path / "out"
    cases = [
        ("no style is given", lambda: anystyle.stylize(photographs, [], model=stylizer, out=out)),
        ("the text of a style is empty", lambda: anystyle.stylize(photographs, " ", model=stylizer, out=out)),
        ("there is no image", lambda: anystyle.stylize(photographs, tmp_path / "a.png", model=stylizer, out=out)),
        ("neither an image nor a text", lambda: anystyle.stylize(photographs, Style(), model=stylizer, out=out)),
        ("no folder, image or video", lambda: anystyle.stylize(tmp_path / "none", "a", model=stylizer, out=out)),
        ("between 0 and 1, not 1.5", lambda: Mixture("a", "b", 1.5)),
        ("poses=guessed; choose one of", lambda: PoseOptions("guessed")),
        (r"export\.colmap=zip; choose one of", lambda: ExportOptions("zip")),
        ("give one of them", lambda: ViewOptions(short_side=56, resize=False)),
        ("Did you mean 'tiny'", lambda: anystyle.stylize(photographs, "a", model="tyny", out=out)),
    ]
    for expected, call in cases:
        with pytest.raises(ValueError, match=expected) as caught:
            call()
        assert "\n" not in str(caught.value) and not out.exists()


def test_names_are_plain_and_bounded():
    assert slug("Étude in Blau/Weiß\n../../etc") == "étude-in-blau-weiß-etc"
    for title in ("梵高 的 星空", "звёздная ночь", "ليلة النجوم", "तारों भरी रात"):
        assert slug(title) == title.replace(" ", "-")[: len(slug(title))] and len(slug(title).encode()) <= 40
    assert slug("🌊") == "style" and slug("🌊 Welle") == "welle"
    assert slug("…") == "style" and len(slug("word " * 100)) <= 40


def test_a_style_has_the_name_that_it_is_given_else_the_paintings_title(stylizer, tmp_path):
    Image.new("RGB", (40, 30), (200, 30, 30)).save(tmp_path / "45.jpg")
    picture = tmp_path / "45.jpg"
    styles = [Named(picture, "Blue  Horses"), Path("example:wave"), picture, Named("ink", "Tinte")]
    embedded = embed_styles(styles, stylizer)
    assert [style.title for style in embedded] == ["Blue Horses", "The Great Wave off Kanagawa", "45", "Tinte"]
    assert [style.name for style in embedded] == ["blue-horses", "the-great-wave-off-kanagawa", "45", "tinte"]
    assert torch.equal(embedded[0].embedding.vector, embedded[2].embedding.vector)
