import json
import os
import re
import subprocess
import sys
from functools import partial

import av
import numpy as np
import pytest
import torch
from PIL import Image
from plyfile import PlyData

from anystyle.commands import film, stylize
from anystyle.errors import UserError
from anystyle.formats import Ply
from anystyle.io.atomic import folder_lock
from anystyle.io.video import write_video
from anystyle.pipeline.saved import read_saved
from anystyle.stylizer import Stylizer
from anystyle_formats.command_export import export, parser
from anystyle_formats.html import Html
from anystyle_formats.splat import Splat
from tests.support.pictures import save_photographs
from tests.support.program import failing

SMALL = ["video.frames=3", "video.scale=0.5", "views.take=3", "views.short_side=56"]


def run(*words):
    stylize.main([str(word) for word in words])


fails = partial(failing, stylize.main)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    return save_photographs(tmp_path_factory.mktemp("photographs"), ("IMG 0.png", "IMG 1.png"), 60, 80)


def test_an_unknown_painting_is_told_before_a_scene_is_made(capsys, tmp_path):
    line = fails(capsys, "example:street", "--image", "example:waves", "--out", tmp_path / "out", *SMALL)
    assert line.startswith("anystyle: error: no example is named 'waves'. Did you mean 'wave'? Available: ")


def test_masks_of_photographs_are_counted_and_told_of(photographs, tmp_path, capsys, caplog):
    masks = tmp_path / "masks"
    missing = fails(capsys, photographs, "--text", "stripes", "--photo-masks", masks, "--out", tmp_path / "out", *SMALL)
    assert "there is no folder of masks" in missing and not (tmp_path / "out").exists()
    masks.mkdir()
    half = np.zeros((60, 80), np.uint8)
    half[:, 40:] = 255
    Image.fromarray(half).save(masks / "IMG 1.png")
    run(photographs, "--text", "stripes", "--photo-masks", masks, "--out", tmp_path / "out", "poses=predicted", *SMALL)
    assert "masks of 1 of 2 photographs: 0% of the pixels are empty, 2" in capsys.readouterr().err
    assert "1 of 2 photographs have no mask" in caplog.text and "the single pass knows no masks" in caplog.text
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["reconstruction"]["masks"]["photographs"] == 1
    saved = fails(capsys, tmp_path / "out", "--text", "dots", "--photo-masks", masks, "--out", tmp_path / "two", *SMALL)
    assert "masks belong to photographs" in saved


def test_every_file_is_there_and_agrees(photographs, tmp_path):
    run(photographs, "--text", "red and white stripes", "--out", tmp_path / "out", *SMALL)
    out = tmp_path / "out"
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()) == [
        ".anystyle",
        "cameras.json",
        "renders/IMG 0.png",
        "renders/IMG 1.png",
        "report.json",
        "scene.ply",
        "scene.safetensors",
        "sheet.png",
        "unstyled.safetensors",
        "video.mp4",
    ]
    report = json.loads((out / "report.json").read_text())
    assert {"gaussians", "views", "seconds", "weights", "seed", "config", "versions"} <= report.keys()
    assert PlyData.read(out / "scene.ply")["vertex"].count == report["gaussians"] > 0
    assert report["views"] == 2 and all(seconds >= 0 for seconds in report["seconds"].values())
    assert set(report["weights"]) >= {"backbone", "style_encoder", "style_encoder/magenta_text", "branch"}
    with Image.open(out / "renders" / "IMG 0.png") as render:
        assert render.size == (70, 56)
    cameras = json.loads((out / "cameras.json").read_text())
    assert [view["name"] for view in cameras["views"]] == ["IMG 0", "IMG 1"] and cameras["views"][0]["width"] == 80
    style = ["--style", "red and white stripes"]
    film.main([str(out), "--out", str(tmp_path / "again.mp4"), *style, "video.frames=3", "video.scale=0.5"])
    for made in (out / "video.mp4", tmp_path / "again.mp4"):
        with av.open(str(made)) as container:
            assert [(frame.width, frame.height) for frame in container.decode(video=0)] == 3 * [(36, 28)]


def test_a_result_that_cannot_be_written_leaves_nothing(photographs, tmp_path, capsys, monkeypatch):
    kept = Ply.write

    def write(self, scene, path):
        if scene.title == "“second”":
            raise UserError("the disk is on fire")
        kept(self, scene, path)

    monkeypatch.setattr(Ply, "write", write)
    words = ["--text", "first", "--text", "second", "--text", "third"]
    assert fails(capsys, photographs, *words, "--out", tmp_path / "out", *SMALL).endswith("the disk is on fire")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("display", [True, False])
def test_a_browser_opens_where_there_is_a_display(tmp_path, display):
    browser = tmp_path / "browser"
    browser.write_text(f"#!/bin/sh\necho $1 > {tmp_path}/opened\n")
    browser.chmod(0o755)
    shown = {"DISPLAY": ":9"} if display else {}
    clean = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    code = f"from anystyle.cli.run import show; show({(tmp_path / 'page.html').as_uri()!r})"
    environment = clean | shown | {"BROWSER": f"{browser} %s"}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=True, capture_output=True).stdout == b""
    assert (tmp_path / "opened").is_file() == display
    assert not display or (tmp_path / "opened").read_text() == (tmp_path / "page.html").as_uri() + "\n"


def test_styles_that_move_gaussians_have_a_page_each(photographs, tmp_path):
    for name, color in (("red", (200, 30, 30)), ("blue", (30, 30, 200))):
        Image.new("RGB", (40, 30), color).save(tmp_path / f"{name}.png")
    images = ("--image", tmp_path / "red.png", "--image", tmp_path / "blue.png")
    words = ("method=optimize", "loss=[total_variation]", "method.num_steps=1", "method.means_lr=0.1")
    run(photographs, *images, "--export", "html", "--out", tmp_path / "out", *words, *SMALL)
    pages = {str(path.relative_to(tmp_path / "out")) for path in tmp_path.glob("out/**/scene.html")}
    assert pages == {"01-red/scene.html", "02-blue/scene.html"}
    styles = dict(read_saved(tmp_path / "out").styles)
    assert list(styles) == ["unstyled", "red", "blue"]
    assert not torch.equal(styles["red"].means, styles["unstyled"].means)


@pytest.mark.parametrize("count", [1, 2])
def test_what_a_format_cannot_write_is_told_and_all_else_is_kept(photographs, tmp_path, capsys, monkeypatch, count):
    def refuse(self, scene, path):
        raise UserError("no room for it")

    def lacking(self, scene, path):
        raise ImportError("an extra is missing")

    monkeypatch.setattr(Html, "write", refuse)
    monkeypatch.setattr(Splat, "write", lacking)
    texts = ("--text", "dots", "--text", "stripes")[: 2 * count]
    line = fails(capsys, photographs, *texts, "--export", "html,splat,spz", "--out", tmp_path / "out", *SMALL)
    out, folders = tmp_path / "out", [""] if count == 1 else ["01-dots/", "02-stripes/"]
    missing = [f"{folder}scene.splat: an extra is missing" for folder in folders]
    assert all(f" {part}; " in line for part in (*missing, "scene.html: no room for it"))
    assert line.endswith(f"not written, and all else is in {out}")
    names = {str(path.relative_to(out)) for path in out.rglob("scene.*")}
    assert names == {f"{folder}scene.{kind}" for folder in folders for kind in ("ply", "safetensors", "spz", "spz.txt")}
    assert (out / "report.json").is_file() and (out / "sheet.png").is_file()


def test_a_bug_of_a_format_shows_its_traceback_when_all_else_is_written(photographs, tmp_path, monkeypatch):
    def broken(self, scene, path):
        raise IndexError("of a plugin")

    monkeypatch.setattr(Splat, "write", broken)
    with pytest.raises(IndexError, match="of a plugin") as caught:
        run(photographs, "--text", "dots", "--export", "splat", "--out", tmp_path / "out", *SMALL)
    assert any(note.endswith(f"all else is in {tmp_path / 'out'}") for note in caught.value.__notes__)
    assert (tmp_path / "out" / "scene.ply").is_file() and (tmp_path / "out" / "report.json").is_file()


def test_several_styles_share_one_encoding_and_the_same_command_gives_the_same_bytes(
    photographs, tmp_path, capsys, monkeypatch
):
    Image.new("RGB", (40, 30), (200, 30, 30)).save(tmp_path / "Red Painting.jpg")
    encoded = []
    original = Stylizer.encode
    monkeypatch.setattr(Stylizer, "encode", lambda self, views: encoded.append(1) or original(self, views))
    title = "a, 'b' = \"c\"\nd {x: [1, 2]} ${y}"
    words = ["--text", title, "--image", tmp_path / "Red Painting.jpg", "--export", "spz,html"]
    out, again = tmp_path / "out", tmp_path / "again"
    run(photographs, *words, "--out", out, *SMALL)
    assert len(encoded) == 1
    report = json.loads((out / "report.json").read_text())
    seconds, share = report["seconds"], report["write_share"]
    assert 0 < share < 1 and share == pytest.approx(seconds["write"] / sum(seconds.values()), abs=1e-3)
    told = f"{sum(seconds.values()):.0f} s, {share:.0%} of them for files; look at {out / 'scene.html'}"
    assert told in capsys.readouterr().out.splitlines()[-1]
    # The page holds all styles; a file with room for one lies in the folder of each.
    names = {str(path.relative_to(out)) for path in out.rglob("scene.*")}
    first, second = "01-a-b-c-d-x-1-2-y", "02-red-painting"
    assert {path.name for path in out.iterdir() if path.is_dir()} == {first, second}
    assert {f"{first}/scene.spz", f"{second}/scene.spz", "scene.html"} <= names
    assert not {f"{first}/scene.html", "scene.spz", "scene.ply"} & names
    titles = ["unstyled", f"“{' '.join(title.split())}”", "Red Painting"]
    assert [title for title, _ in read_saved(out).styles] == titles
    manifest = json.loads(re.search(r'id="manifest">(.*?)</script>', (out / "scene.html").read_text(), re.S)[1])
    assert [style["title"] for style in manifest["styles"]] == titles
    assert [style.get("picture", "")[:16] for style in manifest["styles"]] == ["", "", "data:image/webp;"]
    ((painting, picture),) = read_saved(out).pictures.items()  # a page that is written later has it, too
    assert painting == "Red Painting" and np.abs(np.asarray(picture).astype(int) - (200, 30, 30)).max() < 4
    # The tensors beside them are scenes, too.
    for scene, style in ((out / "unstyled.safetensors", 0), (out / first / "scene.safetensors", 1)):
        alone, (title, gaussians) = read_saved(scene), read_saved(out).styles[style]
        assert [name for name, _ in alone.styles] == [title] and len(alone.names) == 2
        assert torch.equal(alone.styles[0][1].harmonics, gaussians.harmonics)
    export(parser().parse_args([str(out / "unstyled.safetensors"), "--out", str(tmp_path / "unstyled.ply")]))
    assert PlyData.read(tmp_path / "unstyled.ply")["vertex"].count == report["gaussians"]
    for missing in ("scene.ply", "scene.safetensors", "nothing"):
        with pytest.raises(UserError, match=f"there is no file or folder {tmp_path / missing}$"):
            export(parser().parse_args([str(tmp_path / missing), "--out", str(tmp_path / "a.ply")]))
    run(photographs, *words, "--out", again, *SMALL)
    of_style = ("scene.ply", "scene.safetensors", "renders/IMG 1.png", "sheet.png", "cameras.json", "video.mp4")
    for file in ("sheet.png", *(f"{second}/{name}" for name in of_style)):
        assert (out / file).read_bytes() == (again / file).read_bytes(), file


def test_a_single_view_and_a_video_just_work(photographs, tmp_path):
    run(photographs / "IMG 0.png", "--text", "dots", "--out", tmp_path / "one", *SMALL)
    write_video((torch.rand(3, 48, 64) for _ in range(6)), tmp_path / "walk.mp4")
    run(tmp_path / "walk.mp4", "--text", "dots", "--out", tmp_path / "walk", *SMALL)
    assert len(list((tmp_path / "walk" / "renders").iterdir())) == 3


def test_bad_input_ends_in_one_line_and_leaves_nothing(photographs, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "fake.png").write_text("no image")
    text, out = ("--text", "dots"), ("--out", tmp_path / "out")
    cases = {
        "no style is given": (photographs, *out),
        "no images in the folder": (tmp_path / "empty", *text, *out),
        "no photographs are given": (*text, *out),
        "is not an image": (photographs, "--image", tmp_path / "fake.png", *out),
        "is a file": (photographs, *text, "--out", tmp_path / "file"),
        "Not a directory": (photographs, *text, "--out", tmp_path / "file" / "out"),
        "no weights file": (photographs, *text, *out, "weights.branch=absent.safetensors"),
        "does not fit this StyleBranch": (photographs, *text, *out, "model=tiny", "placement=full"),
    }
    for expected, words in cases.items():
        assert expected in fails(capsys, *words, *SMALL)
        assert not (tmp_path / "out").exists(), expected


def test_a_truncated_weights_file_and_one_of_another_part(photographs, tmp_path, capsys):
    from anystyle.pipeline.load import weights_file

    whole = weights_file("tiny_branch").read_bytes()
    (tmp_path / "half.safetensors").write_bytes(whole[: len(whole) // 2])
    words = (photographs, "--text", "dots", "--out", tmp_path / "out", *SMALL)
    assert "truncated" in fails(capsys, *words, f"weights.branch={tmp_path / 'half.safetensors'}")
    assert "but those of a branch are needed" in fails(capsys, *words, "weights.branch=tiny_backbone")


def test_a_full_disk_leaves_the_results_of_the_last_run(photographs, tmp_path, capsys, monkeypatch):
    words = (photographs, "--text", "dots", "--out", tmp_path / "out", *SMALL)
    run(*words)
    before = {path: path.read_bytes() for path in sorted((tmp_path / "out").rglob("*")) if path.is_file()}

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device", "scene.ply")

    monkeypatch.setattr("anystyle.io.ply.PlyData.write", full)
    assert "No space left on device" in fails(capsys, *words)
    assert {path: path.read_bytes() for path in sorted((tmp_path / "out").rglob("*")) if path.is_file()} == before


def test_a_folder_of_other_results_is_refused_and_replaced_where_it_is_asked_for(
    photographs, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(photographs.parent)
    out, words = tmp_path / "out", [photographs.name, "--text", "gold", *SMALL]
    run(*words, "--text", "silver", "--out", out)
    made = json.loads((out / "report.json").read_text())["style"]
    (out / "01-gold" / "retouched.psd").write_text("mine")
    with monkeypatch.context() as patched:
        patched.setattr("anystyle.pipeline.stylize.load_model", lambda *_, **__: pytest.fail("the work began"))
        refused = fails(capsys, *words, "--out", out)
    assert f"{out} holds results of another run; --overwrite" in refused
    assert json.loads((out / "report.json").read_text())["style"] == made
    run(*words, "--out", out, "--overwrite")
    assert json.loads((out / "report.json").read_text())["style"] == "“gold”"
    assert (out / "01-gold" / "retouched.psd").is_file() and not (out / "02-silver").exists()
    run(*words, "--out", out)  # the same again
    run("--again", out / "report.json", "--out", out)
    monkeypatch.chdir(tmp_path)
    (tmp_path / photographs.name).symlink_to(photographs)
    assert "holds results of another run" in fails(capsys, *words, "--out", out)  # photographs of another folder
    assert "holds results of another run" in fails(capsys, "--again", out / "report.json", "seed=1", "--out", out)


def test_a_second_run_into_a_folder_is_told_before_its_work(photographs, tmp_path, capsys):
    out = tmp_path / "out"
    with folder_lock(out, "taken"):
        line = fails(capsys, photographs, "--text", "gold", "--out", out, "weights.branch=absent.safetensors", *SMALL)
    assert f"another run writes its results to {out}; wait for its end" in line and not out.exists()


def test_a_backbone_from_a_folder_outside_the_project_stylizes(photographs, tmp_path, monkeypatch):
    from anystyle.commands import plugins_new

    assert plugins_new.main(["backbone", "elsewhere", "--into", str(tmp_path / "folders")]) == 0
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path / "folders"))
    words = ["~model", "backbone=elsewhere", "--text", "dots", "--out", tmp_path / "out"]
    run(photographs, *words, *SMALL)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["config"]["backbone"]["_target_"].endswith("Elsewhere")
    assert report["weights"] == {} and report["gaussians"] > 0
