"""The code that docs/data.md shows for WebDataset's archives, exactly as it stands there."""

import shlex
import sys

import pytest
import torch

from anystyle.contracts import SceneSource
from anystyle.data.scene_folder import FolderScenes
from anystyle.io.atomic import write_json
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.testing import assert_contract
from anystyle.training.data import SceneBatches, StepLoader
from tests.support.docs_cases import ROOT, blocks
from tests.support.docs_world import _picture

pytest.importorskip("webdataset", reason="the page's archives are WebDataset's: pip install webdataset")
PAGE = ROOT / "docs" / "data.md"


def shown(language, words):
    (code,) = (code for code in blocks(PAGE, language) if words in code)
    return code


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of two scenes, one with cameras and one without, their archives, and the plugin that reads these."""
    monkeypatch.chdir(tmp_path)
    FolderScenes.example(tmp_path / "DL3DV-10K")
    (tmp_path / "DL3DV-10K/garden/images").rename(tmp_path / "DL3DV-10K/garden/images_8")
    for number in range(4):
        _picture(tmp_path / "DL3DV-10K/lane/images_8" / f"{number}.jpg", seed=number)
    write_json(tmp_path / "DL3DV-10K" / "train_index.json", ["lane", "garden"])
    exec(shown("python", "TarWriter"), {})
    plugin = tmp_path / "tar_scenes"
    plugin.mkdir()
    (plugin / "tar_scenes.py").write_text(shown("python", "class TarScenes"))
    (plugin / "pyproject.toml").write_text(shown("toml", "TarScenes"))
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(plugin))
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield FolderScenes(root="DL3DV-10K", images="images_8", index="train_index.json", short_side=270, multiple=1)
    sys.modules.pop("tar_scenes", None)


def archives(before=""):
    """What the page's words choose, with something before each path."""
    (line,) = (line for line in PAGE.read_text().splitlines() if line.startswith("anystyle train") and "urls" in line)
    words = [word.replace("shards/", f"{before}shards/") for word in shlex.split(line)]
    return build(SceneSource, compose("train", [*words[2:], "name=x", "out=x"]).scenes)


@pytest.mark.parametrize("before", ["", "pipe:cat "])
def test_archives_give_what_the_folder_gives(folder, before):
    scenes = archives(before)
    assert len(scenes) == len(folder) == 2
    for scene in range(2):
        views, expected = scenes.read(scene, [2, 0]), folder.read(scene, [2, 0])
        assert scenes.num_views(scene) == folder.num_views(scene) and views.names == expected.names
        assert torch.equal(views.images, expected.images)
        assert (views.cameras is None) == (expected.cameras is None) == (scene == 0)
        if views.cameras is not None and expected.cameras is not None:
            assert torch.equal(views.cameras.world_from_camera, expected.cameras.world_from_camera)
            assert torch.equal(views.cameras.intrinsics, expected.cameras.intrinsics)


def test_the_plugin_keeps_the_contract_and_feeds_the_workers_of_a_training(folder):
    scenes = archives()
    assert_contract("scenes", type(scenes), urls="shards/{000000..000001}.tar", short_side=28)
    options = {"batch_size": 2, "context_views": (2, 2), "spread": "any", "heights": (28, 56), "width": 56}
    from_archives, from_folder = SceneBatches(scenes, **options), SceneBatches(folder, **options)
    for step, batch in enumerate(StepLoader(from_archives, range(3), rank=0, world=1, workers=2)):
        assert torch.equal(batch.views.images, from_folder.batch(step).views.images)
