"""DL3DV, ScanNet++ and WikiArt as they lie, with something wrong in each, and paintings that are test styles."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.contracts import SceneSource
from anystyle.data.scene_folder import FolderScenes
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.testing.oracle import hashed
from anystyle_datasets.dl3dv import DL3DVScenes
from anystyle_datasets.duplicates import fingerprint, same_pictures
from anystyle_datasets.wikiart import TEST_FILES, WikiArtStyles
from tests.support.pictures import save
from tests.support.real_data import real


def picture(path, seed=0, size=(60, 40)):
    save(path, (hashed(seed, (3, size[1], size[0])) * 255).byte().permute(1, 2, 0).numpy())


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
    words = ["experiment=paper_head", "scenes=scannetpp", f"scenes.root={tmp_path}", "name=x", "out=y"]
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


def test_scenes_at_any_depth_are_taken_but_those_for_tests(tmp_path, caplog):
    """DL3DV as its archives unpack, one of which is not unpacked and one twice as deep."""
    a, b, c, d = (letter * 64 for letter in "abcd")
    for name in (f"1K/{a}", f"1K/{b}/{b}", f"2K/{c}"):
        for number in range(2):
            picture(tmp_path / name / "images_8" / f"frame_{number:05d}.png", seed=number)
    (tmp_path / "2K" / f"{d}.zip").write_bytes(b"an archive")
    (tmp_path / "2K" / f"{c}.zip").write_bytes(b"an archive")
    (tmp_path / "test_index.json").write_text(json.dumps([f"2K/{c}"]))

    def names():
        scenes = DL3DVScenes(root=str(tmp_path))
        return [scenes.name(scene) for scene in range(len(scenes))]

    assert names() == [f"1K/{a}", f"1K/{b}/{b}"]
    assert f"2K has 1 archives that are not unpacked, such as {d}.zip" in caplog.text
    (tmp_path / "train_index.json").write_text(json.dumps([f"2K/{c}"]))
    assert names() == [f"2K/{c}"]
    (tmp_path / "train_index.json").unlink()
    (tmp_path / "test_index.json").write_text("{}")
    with pytest.raises(ValueError, match="list of folder names"):
        names()


SMALL = (
    "model=tiny weights.branch=null trainer=cpu loss.content.network=texture loss.style.network=texture "
    "loss.clip_directional.size=96 loss.clip_patch.size=96 loss.clip_patch.crops=2 training.heights=[112,112] "
    "training.width=112 training.images=4 training.context_views=[2,2] training.spread=any workers=0 "
    "trainer.max_steps=2 name=mini resume=never"
)


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["", "recipe=paper"])
def test_data_as_it_is_downloaded_trains(tmp_path, recipe):
    for number in range(7):
        picture(tmp_path / "DL3DV-10K/1K/scene/images_8" / f"{number}.png", seed=number, size=(64, 48))
    picture(tmp_path / "DL3DV-10K/2K/short/images_8/0.png", size=(64, 48))
    for number, name in enumerate(("Cubism/a.jpg", "Ukiyo_e/b.jpg")):
        picture(tmp_path / "wikiart" / name, seed=number)
    command = [sys.executable, "-m", "anystyle", "train", "experiment=paper_head", *SMALL.split(), *recipe.split()]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0 and "2 steps done" in done.stdout, done.stderr[-1500:]
    assert "skipped: 2K/short: a scene" in done.stderr


def test_a_style_list_that_overlaps_the_test_list_is_refused(tmp_path):
    for number, name in enumerate(("Op_Art/a.png", "Op_Art/b.png", "Fauvism/c.png", "Fauvism/d.png")):
        picture(tmp_path / name, seed=number)
    (tmp_path / TEST_FILES).write_text("Op_Art/b.png\n")
    (tmp_path / "stylos.txt").write_text("c.png\n")
    (tmp_path / "mine.txt").write_text("Op_Art/a.png\nOp_Art/b.png\nFauvism/c.png\n")
    options = {"root": str(tmp_path), "size": 16, "exclude": (str(tmp_path / "stylos.txt"),)}
    assert [path.name for path in WikiArtStyles(**options).paths] == ["d.png", "a.png"]
    with pytest.raises(ValueError, match=r"2 paintings in common: Fauvism/c.png, Op_Art/b.png"):
        WikiArtStyles(**options, files=str(tmp_path / "mine.txt"))
    (tmp_path / "mine.txt").write_text("Op_Art/a.png\n")
    assert [path.name for path in WikiArtStyles(**options, files=str(tmp_path / "mine.txt")).paths] == ["a.png"]
    with pytest.raises(ValueError, match=r"list of paintings .exclude. gone"):
        WikiArtStyles(root=str(tmp_path), exclude=("gone.txt",))


def test_copies_of_a_painting_are_found_whatever_their_name_size_and_format(tmp_path):
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
    assert min([(a ^ b).bit_count() for i, a in enumerate(prints) for b in prints[:i]]) > 30
