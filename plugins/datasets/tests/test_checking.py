"""What `anystyle data check` finds, in folders of each layout with something wrong in each."""

import json
import shlex
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.contracts import SceneSource
from anystyle.data.scene_folder import FolderScenes
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.testing.oracle import hashed
from anystyle_datasets.checking import check, guess
from anystyle_datasets.command import Data
from anystyle_datasets.duplicates import fingerprint, same_pictures
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import DESCRIPTIONS, TEST_FILES, WikiArtStyles
from tests.support.real_data import real


def picture(path, seed=0, size=(60, 40)):
    path.parent.mkdir(parents=True, exist_ok=True)
    levels = (hashed(seed, (3, size[1], size[0])) * 255).byte().permute(1, 2, 0).numpy()
    Image.fromarray(levels).save(path)


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.fixture
def dl3dv(tmp_path):
    """Three scenes as DL3DV lays them out: one good, one with a hole and a torn file, one of a single view."""
    for name, count in (("1K/good", 4), ("1K/torn", 4), ("2K/short", 1)):
        frames = []
        for number in range(count):
            picture(tmp_path / name / "images_8" / f"frame_{number:05d}.png", seed=number)
            frames.append({"file_path": f"images/frame_{number:05d}.png", "transform_matrix": np.eye(4).tolist()})
        if name == "1K/torn":
            frames.append({"file_path": "images/frame_00009.png", "transform_matrix": np.eye(4).tolist()})
        content = {"w": 480, "h": 320, "fl_x": 400, "fl_y": 400, "cx": 240, "cy": 160, "frames": frames}
        (tmp_path / name / "transforms.json").write_text(json.dumps(content))
    truncate(tmp_path / "1K/torn/images_8/frame_00002.png")
    (tmp_path / "train_index.json").write_text(json.dumps(["1K/good", "1K/torn", "2K/short", "3K/gone"]))
    return tmp_path


def test_scenes_are_counted_and_what_is_wrong_is_named(dl3dv):
    report = check(dl3dv)
    assert (report.layout, report.usable, report.images) == ("scenes", ["1K/good", "1K/torn"], 8)
    assert report.sizes == {(60, 40): 8} and sorted(report.views.elements()) == [1, 3, 4]
    assert report.use == f"scenes=dl3dv scenes.root={dl3dv}"
    found = "\n".join(report.problems)
    for words in ("3K/gone: in train_index.json", "frame_00002.png is a damaged", "names images/frame_00009.png"):
        assert words in found
    assert "1 views, fewer" in found
    assert len(report.problems) == 4
    assert len(check(dl3dv, decode=False).usable) == 2


def test_scannet_is_found_where_it_keeps_its_photographs_and_cameras(tmp_path):
    for scene in ("0a5c013435", "1ada7a0617"):
        dslr, frames = tmp_path / scene / "dslr", []
        for number in range(3):
            picture(dslr / "resized_undistorted_images" / f"DSC0{number}.JPG", seed=number)
            pose = np.eye(4)
            pose[0, 3] = number
            frames.append({"file_path": f"DSC0{number}.JPG", "transform_matrix": pose.tolist()})
        content = {"w": 60, "h": 40, "fl_x": 50, "fl_y": 50, "cx": 30, "cy": 20, "frames": frames}
        (dslr / "nerfstudio").mkdir()
        (dslr / "nerfstudio" / "transforms_undistorted.json").write_text(json.dumps(content))
    report = check(tmp_path)
    assert (report.layout, len(report.usable), report.images, report.problems) == ("scenes", 2, 6, [])
    # The words it prints compose to the source of this layout, whatever the experiment takes.
    assert report.use == f"scenes=scannetpp scenes.root={tmp_path}" and report.posed == 6
    words = ["experiment=paper_head", *report.use.split(), "name=x", "out=y"]
    node = compose("train", [*words, "scenes.short_side=20", "scenes.multiple=10"]).scenes
    scenes = build(SceneSource, node)
    options = {name: node[name] for name in ("root", "images")}
    views = scenes.read(1, [0, 2])
    assert scenes.name(1) == "1ada7a0617" and views.cameras.world_from_camera[0, 1, 0, 3] == 2
    torch.testing.assert_close(views.cameras.intrinsics[0, 0, 0, 0], torch.tensor(25.0))
    # COLMAP's model, or nothing, at the place that is named.
    for cameras in ("dslr/colmap", "dslr/nerfstudio", "gone.json"):
        (tmp_path / "1ada7a0617/dslr/colmap").mkdir(exist_ok=True)
        with pytest.raises(ValueError, match="is not there, or holds no cameras; cameras= is relative to"):
            FolderScenes(**options | {"cameras": cameras}).read(1, [0])


def test_clips_are_counted_by_their_chunks(tmp_path):
    Re10kScenes.example(tmp_path)
    (clip,) = torch.load(tmp_path / "train" / "0.torch", weights_only=True)
    frame = clip["images"][0]
    clips = [clip | {"key": "a"}, {"key": "b", "cameras": clip["cameras"][:1], "images": [frame]}]
    torch.save(clips, tmp_path / "train" / "0.torch")
    (tmp_path / "train" / "index.json").write_text(json.dumps({"a": "0.torch", "b": "0.torch", "c": "1.torch"}))
    report = check(tmp_path)
    assert (guess(tmp_path), report.usable, report.images, report.posed) == ("re10k", ["train/a"], 4, 4)
    # The size is that of the stored frames, not of what a training makes of them.
    assert report.sizes == {(48, 27): 4}
    assert len(report.problems) == 2 and "1.torch" in "\n".join(report.problems)
    clips[0]["images"] = [frame, frame[: len(frame) // 2], frame]
    torch.save(clips, tmp_path / "train" / "0.torch")
    report = check(tmp_path)
    assert (len(report.usable), report.images) == (1, 3)
    assert [line for line in report.problems if line.startswith("train/a: frame 1 is a damaged image")]
    words = ["experiment=paper_head", *report.use.split(), "name=x", "out=y"]
    assert build(SceneSource, compose("train", words).scenes).num_views(0) == 3


def test_paintings_are_held_against_their_descriptions_and_lists(tmp_path, capsys):
    for number, name in enumerate(("Op_Art/a.png", "Op_Art/b.png", "Fauvism/c.png")):
        picture(tmp_path / name, seed=number)
    (tmp_path / "Fauvism/torn.png").write_bytes(b"nothing")
    (tmp_path / DESCRIPTIONS).write_text("Op_Art/a.png;from dark to light\nOp_Art/gone.png;dots\n")
    (tmp_path / TEST_FILES).write_text("Op_Art/b.png\nOp_Art/absent.png\n")
    Data()(["check", str(tmp_path)])
    told = capsys.readouterr().out
    problems = ("torn.png is not an image", "Op_Art/gone.png has a description", "names Op_Art/absent.png")
    for words in ("layout    wikiart", "images    3\n", "texts     1\n", "problems  3\n", *problems):
        assert words in told


def test_a_folder_of_nothing_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no folder"):
        check(tmp_path / "gone")
    with pytest.raises(ValueError, match="no scene lies there"):
        check(tmp_path)
    with pytest.raises(UserError, match="Did you mean 'check'"):
        Data()(["chekc"])


def test_scenes_at_any_depth_are_listed_once(tmp_path, capsys):
    """DL3DV as its archives unpack: the list that ``scenes=dl3dv`` reads is written of the scenes that can be used."""
    for name, count in (("1K/" + "a" * 64, 4), ("1K/" + "b" * 64, 1), ("2K/" + "c" * 64, 3)):
        for number in range(count):
            picture(tmp_path / name / "images_8" / f"frame_{number:05d}.png", seed=number)
    (tmp_path / "2K" / ("d" * 64 + ".zip")).write_bytes(b"an archive")
    (tmp_path / "test_index.json").write_text(json.dumps(["2K/" + "c" * 64]))

    def say(*words):
        Data()(["check", str(tmp_path), *words])
        return capsys.readouterr().out

    told = say()
    for words in ("1 that can be used, of 2", "train_index.json is not there", "1 scenes are packed, such as"):
        assert words in told
    assert told.endswith(f"next      anystyle data check {tmp_path} --index\n")
    assert say("--min-views", "3", "--headers").endswith(f"check {tmp_path} --min-views 3 --headers --index\n")
    told = say("--index")
    assert json.loads((tmp_path / "train_index.json").read_text()) == ["1K/" + "a" * 64]
    assert f"next      anystyle train experiment=paper_head scenes=dl3dv scenes.root={tmp_path}\n" in told
    assert "1 that can be used, of 1" in say()
    with pytest.raises(UserError, match=r"train_index.json is there already; delete it"):
        Data()(["check", str(tmp_path), "--index"])


def test_what_is_still_to_be_unpacked_is_named(tmp_path, capsys):
    archive = tmp_path / "DL3DV" / "1K" / ("a" * 64 + ".zip")
    for path in (
        archive,
        tmp_path / "wikiart" / "data" / "train-00000.parquet",
        tmp_path / "re10k" / "train" / "a.txt",
    ):
        path.parent.mkdir(parents=True)
        path.write_bytes(b"packed")
    for name, words in {
        "DL3DV": f"1 scenes are packed, such as {archive}",
        "wikiart": "1 tables of paintings are not unpacked",
        "re10k": "train: 1 of 1 camera lists are in no chunk",
    }.items():
        with pytest.raises(UserError, match="holds nothing that can be used"):
            Data()(["check", str(tmp_path / name)])
        assert words in capsys.readouterr().out


def test_options_that_do_not_fit_are_refused(tmp_path):
    picture(tmp_path / "styles" / "a.png")
    with pytest.raises(UserError, match="--write FILE needs --against FOLDER"):
        Data()(["check", str(tmp_path / "styles"), "--write", "list.txt"])
    with pytest.raises(UserError, match="--index is for scenes as DL3DV lays them out"):
        Data()(["check", str(tmp_path / "styles"), "--index"])


SMALL = (
    "model=tiny weights.branch=null trainer=cpu loss.content.network=texture loss.style.network=texture "
    "loss.clip_directional.size=96 loss.clip_patch.size=96 loss.clip_patch.crops=2 training.heights=[112,112] "
    "training.width=112 training.images=4 training.context_views=[2,2] training.spread=any workers=0 "
    "trainer.max_steps=2 name=mini resume=never"
)


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["", "recipe=paper", "recipe=published"])
def test_the_words_that_check_prints_train(tmp_path, capsys, recipe):
    for number in range(7):
        picture(tmp_path / "scenes" / "1K" / "scene" / "images_8" / f"{number}.png", seed=number, size=(64, 48))
    for number, name in enumerate(("Cubism/a.jpg", "Ukiyo_e/b.jpg")):
        picture(tmp_path / "wikiart" / name, seed=number)
    printed = []
    for words in ([str(tmp_path / "scenes"), "--index"], [str(tmp_path / "wikiart")]):
        Data()(["check", *words])
        printed.append(shlex.split(capsys.readouterr().out.splitlines()[-1])[2:])
    scenes, styles = printed
    command = [sys.executable, "-m", "anystyle", *scenes, *styles[2:], *SMALL.split(), *recipe.split()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0 and "2 steps done" in done.stdout, done.stderr[-1500:]


def test_a_style_list_that_overlaps_the_test_list_is_refused(tmp_path):
    for number, name in enumerate(("Op_Art/a.png", "Op_Art/b.png", "Fauvism/c.png", "Fauvism/d.png")):
        picture(tmp_path / name, seed=number)
    (tmp_path / TEST_FILES).write_text("Op_Art/b.png\n")
    (tmp_path / "stylos.txt").write_text("c.png\n")
    (tmp_path / "mine.txt").write_text("Op_Art/a.png\nOp_Art/b.png\nFauvism/c.png\n")
    options = {"root": str(tmp_path), "size": 16, "exclude": (str(tmp_path / "stylos.txt"),)}
    kept = WikiArtStyles(**options)
    assert [path.name for path in kept.paths] == ["d.png", "a.png"]
    with pytest.raises(ValueError, match=r"2 paintings in common: Fauvism/c.png, Op_Art/b.png"):
        WikiArtStyles(**options, files=str(tmp_path / "mine.txt"))
    (tmp_path / "mine.txt").write_text("Op_Art/a.png\n")
    assert [path.name for path in WikiArtStyles(**options, files=str(tmp_path / "mine.txt")).paths] == ["a.png"]
    with pytest.raises(ValueError, match=r"list of paintings .exclude. gone"):
        WikiArtStyles(root=str(tmp_path), exclude=("gone.txt",))


def test_copies_of_a_painting_are_found_whatever_their_name_size_and_format(tmp_path, capsys):
    paintings = sorted(real("styles").glob("*.jpg"))
    train, tests, expected = tmp_path / "train", tmp_path / "tests", {}
    train.mkdir()
    tests.mkdir()
    for number, path in enumerate(paintings):
        with Image.open(path) as image:
            image.convert("RGB").save(train / path.name)
            if number % 2 == 0:
                expected[train / path.name] = tests / f"{number:02d}.png"
                image.convert("RGB").resize((300, 220)).save(expected[train / path.name])
    assert same_pictures(sorted(train.glob("*")), sorted(tests.glob("*"))) == expected
    prints = [fingerprint(path) for path in paintings]
    distances = [(a ^ b).bit_count() for i, a in enumerate(prints) for b in prints[:i]]
    assert min(distances) > 30
    Data()(["check", str(train), "--as", "styles", "--against", str(tests), "--write", str(tmp_path / "exclude.txt")])
    assert f"overlap   {len(expected)} of {len(expected)}" in capsys.readouterr().out
    assert (tmp_path / "exclude.txt").read_text().split() == [path.name for path in sorted(expected)]
