"""Shards give what the folders gave that they were written from, bit for bit, from a disk and from a server."""

import json
import logging
import multiprocessing
import os
import shutil
import signal
import tarfile

import fsspec
import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.contracts import SceneSource, StyleSource
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.style_folder import FolderStyles
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.training.data import SceneBatches, StepLoader
from anystyle_datasets import shards as shards_module
from anystyle_datasets.command import Data
from anystyle_datasets.packing import pack
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.shard_sources import ShardScenes, ShardStyles
from anystyle_datasets.wikiart import WikiArtStyles
from tests.support.range_server import Ranges, Whole, serving

SCENES = 6


def picture(path, seed, size=(360, 240), **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    noise = np.random.default_rng(seed).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(noise).save(path, **options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Scenes with cameras and without, one turned, one of two formats, one that cannot be read; and styles."""
    root = tmp_path_factory.mktemp("data")
    for scene in range(SCENES):
        frames = []
        for number in range(4):
            picture(root / "scenes" / f"s{scene}" / "images" / f"f.{number}.png", seed=10 * scene + number)
            pose = np.eye(4)
            pose[:3, 3] = np.random.default_rng(scene + number).normal(size=3)
            frames.append({"file_path": f"images/f.{number}.png", "transform_matrix": pose.tolist()})
        if scene % 2 == 0:
            content = {"w": 720, "h": 480, "fl_x": 500 / 3, "fl_y": 480, "cx": 361.7, "cy": 239.1, "frames": frames}
            (root / "scenes" / f"s{scene}" / "transforms.json").write_text(json.dumps(content))
    exif = Image.Exif()
    exif[0x0112] = 6
    for number in range(3):
        picture(root / "scenes" / "turned" / f"{number}.jpg", seed=number, size=(60, 40), exif=exif)
    picture(root / "scenes" / "z_lost" / "a.png", seed=1, size=(60, 40))
    frames = [{"file_path": "b.png", "transform_matrix": np.eye(4).tolist()}]
    (root / "scenes" / "z_lost" / "transforms.json").write_text(json.dumps(content | {"frames": frames}))
    half = root / "scenes" / "turned" / "1.jpg"
    half.write_bytes(half.read_bytes()[:1500])
    for number in range(3):
        picture(root / "styles" / f"p{number}.png", seed=number, size=(50 + number, 40))
    (root / "styles" / "captions.jsonl").write_text('{"image": "p1.png", "text": "grün, coarse"}\n')
    return root


@pytest.fixture(scope="module")
def sources(folder):
    scenes = FolderScenes(root=str(folder / "scenes"), short_side=56)
    return scenes, FolderStyles(root=str(folder / "styles"), size=28)


@pytest.fixture(scope="module")
def packed(folder, sources):
    out = folder / "shards"
    pack(sources[0], out / "scenes", options={"short_side": 56, "multiple": None}, megabytes=1)
    pack(sources[1], out / "styles", options={"size": 28})
    assert len(list((out / "scenes").glob("*.tar"))) > 3
    return out


@pytest.fixture(scope="module")
def address(packed):
    with serving(packed) as address:
        yield address


@pytest.fixture
def copy(packed, tmp_path):
    shutil.copytree(packed / "scenes", tmp_path / "copy")
    return tmp_path / "copy"


def same_views(one, other):
    assert torch.equal(one.images, other.images) and one.names == other.names
    assert (one.cameras is None) == (other.cameras is None)
    if one.cameras is not None:
        assert torch.equal(one.cameras.world_from_camera, other.cameras.world_from_camera)
        assert torch.equal(one.cameras.intrinsics, other.cameras.intrinsics)


def same_batches(one, other):
    same_views(one.views, other.views)
    assert torch.equal(one.style.image, other.style.image)
    assert (one.style.text, one.style.names, one.keys) == (other.style.text, other.style.names, other.keys)


def batches(scenes, styles):
    return SceneBatches(
        scenes,
        styles,
        seed=5,
        batch_size=2,
        context_views=(2, 2),
        target_views=1,
        spread="any",
        heights=(28, 56),
        flip=0.5,
    )


def test_scenes_are_those_of_the_folder_to_the_last_bit(sources, packed):
    folder, shards = sources[0], ShardScenes(root=str(packed / "scenes"))
    names = [folder.name(scene) for scene in range(len(folder))]
    assert [shards.name(scene) for scene in range(len(shards))] == names
    for scene, name in enumerate(names):
        if name == "z_lost":
            assert shards.num_views(scene) == 0
            continue
        count = shards.num_views(scene)
        assert count == folder.num_views(scene) == (3 if name == "turned" else 4)
        views = [view for view in range(count)[::-1] if (name, view) != ("turned", 1)]
        same_views(shards.read(scene, views), folder.read(scene, views))
    with pytest.raises(UserError, match="damaged image"):
        shards.read(names.index("turned"), [1])
    for wrong in ([], [4], [-1]):
        with pytest.raises(UserError, match="at least one of 0 to 3"):
            shards.read(names.index("s0"), wrong)
    with pytest.raises(UserError, match=f"there are {SCENES + 2}, counted from 0"):
        shards.num_views(len(shards))


def test_options_given_replace_those_of_the_source(folder, packed):
    sized = ShardScenes(root=str(packed / "scenes"), short_side=32, multiple=8).read(0, [0])
    same_views(sized, FolderScenes(root=str(folder / "scenes"), short_side=32, multiple=8).read(0, [0]))
    styles = ShardStyles(root=str(packed / "styles"), size=20)
    assert torch.equal(styles.read(2).image, FolderStyles(root=str(folder / "styles"), size=20).read(2).image)


FORKS = pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
"""From Python 3.12 on; the threads are the server's and fsspec's, and neither outlives a fork."""


@FORKS
def test_a_training_sees_the_same_batches_whoever_asks_and_from_any_step_on(sources, address, caplog):
    from_folder, from_shards = (
        batches(*sources),
        batches(ShardScenes(root=f"{address}/scenes"), ShardStyles(root=f"{address}/styles")),
    )
    for step in range(3):
        whole = from_folder.batch(step)
        same_batches(from_shards.batch(step), whole)
        halves = [from_shards.batch(step, rank, 2) for rank in range(2)]
        for rank, half in enumerate(halves):
            same_batches(half, from_folder.batch(step, rank, 2))
            assert half.keys == whole.keys[rank::2]
        assert sorted(key for half in halves for key in half.keys) == sorted(whole.keys)
    assert any("z_lost" in line or "damaged" in line for line in caplog.messages), "what cannot be read was never drawn"
    # Resumed in the middle, by the loader of a run and its workers.
    resumed = StepLoader(from_shards, start=1, stop=3, rank=1, world=2, workers=2)
    for step, batch in enumerate(resumed, start=1):
        same_batches(batch, from_folder.batch(step, 1, 2))


def test_a_step_reads_its_views_and_no_more(packed, address):
    scenes = ShardScenes(root=f"{address}/scenes")
    Ranges.log.clear()
    scenes.read(0, [1, 3])
    stored = sum((packed.parent / "scenes/s0/images" / f"f.{view}.png").stat().st_size for view in (1, 3))
    assert len(Ranges.log) == 2 and stored < sum(count for _, count in Ranges.log) < stored + 2 * 2048
    assert {path for path, _ in Ranges.log} <= {f"/scenes/{number:06d}.tar" for number in range(9)}


def test_a_busy_server_is_asked_again_and_one_without_ranges_is_told(packed, address, monkeypatch):
    monkeypatch.setattr(shards_module, "PAUSES", (0, 0, 0))
    scenes, expected = ShardScenes(root=f"{address}/scenes"), ShardScenes(root=str(packed / "scenes")).read(0, [0, 1])
    monkeypatch.setattr(Ranges, "busy", 3)
    same_views(scenes.read(0, [0, 1]), expected)
    monkeypatch.setattr(Ranges, "busy", 99)
    with pytest.raises(UserError, match=r"cannot be read .*503"):
        scenes.read(0, [0])
    monkeypatch.setattr(Ranges, "busy", 0)
    with serving(packed, Whole) as without, pytest.raises(UserError, match="the server has to answer ranges"):
        ShardScenes(root=f"{without}/scenes").read(0, [0])


def test_any_file_system_of_fsspec_will_do(packed):
    fsspec.filesystem("memory").put(str(packed / "scenes"), "/bucket/scenes", recursive=True)
    same_views(
        ShardScenes(root="memory://bucket/scenes").read(2, [3]), ShardScenes(root=str(packed / "scenes")).read(2, [3])
    )


def test_storage_without_its_client_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "s3fs", None)
    with pytest.raises(ImportError, match=r's3://bucket: .*pip install "anystyle\[shards\]"'):
        ShardScenes(root="s3://bucket")
    with pytest.raises(UserError, match="nonsense"):
        ShardStyles(root="nonsense://bucket")


def test_the_archives_are_of_files_as_they_were(folder, packed):
    """As WebDataset reads them: consecutive members of one name are a sample."""
    found = []
    for path in sorted((packed / "scenes").glob("*.tar")):
        with tarfile.open(path) as tar:
            members = tar.getmembers()
            for about, image in zip(members[::2], members[1::2], strict=True):
                assert about.name == image.name.split(".")[0] + ".json"
                found.append((json.load(tar.extractfile(about))["name"], tar.extractfile(image).read()))
    scenes = FolderScenes(root=str(folder / "scenes"))
    files = [
        path for scene in range(len(scenes)) if scenes.name(scene) != "z_lost" for path in scenes.shots(scene).pictures
    ]
    assert [content for _, content in found] == [path.read_bytes() for path in files]
    assert [name for name, _ in found[:4]] == ["f.0", "f.1", "f.2", "f.3"]


def test_paintings_keep_texts_and_random_squares_and_clips_their_cameras(tmp_path):
    paintings, clips = tmp_path / "wikiart", tmp_path / "re10k"
    paintings.mkdir()
    clips.mkdir()
    WikiArtStyles.example(paintings)
    picture(paintings / "Op_Art" / "wide.png", seed=1, size=(90, 30))
    styles = WikiArtStyles(root=str(paintings), size=16, crop="random")
    pack(styles, tmp_path / "s", options={"size": 16, "crop": "random"})
    packed = ShardStyles(root=str(tmp_path / "s"))
    assert len(packed) == len(styles) == 4
    for style in range(4):
        torch.manual_seed(style)
        one = styles.read(style)
        torch.manual_seed(style)
        other = packed.read(style)
        assert (one.text, one.names) == (other.text, other.names)
        assert one.image is other.image is None or torch.equal(one.image, other.image)
    Re10kScenes.example(clips)
    scenes = Re10kScenes(root=str(clips), short_side=28)
    pack(scenes, tmp_path / "c", options={"short_side": 28})
    same_views(ShardScenes(root=str(tmp_path / "c")).read(0, [2, 0]), scenes.read(0, [2, 0]))


def killed(source, out, moment):
    """Pack in a process that is killed as it begins its scene of number ``moment``."""

    def die(progress):
        if progress.line == f"packing {moment}/{len(source)}":
            os.kill(os.getpid(), signal.SIGKILL)

    pack(source, out, options={"short_side": 56, "multiple": None}, megabytes=1, on_progress=die)


@FORKS
def test_killed_at_any_scene_it_goes_on_to_the_same_bytes(sources, packed, tmp_path):
    source, context = sources[0], multiprocessing.get_context("fork")
    for moment in range(1, len(source)):
        process = context.Process(target=killed, args=(source, tmp_path, moment))
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        with pytest.raises(UserError, match=r"there is no .*index.json; `anystyle data shard` writes it when it ends"):
            ShardScenes(root=str(tmp_path))
    finished = {path: path.stat().st_mtime_ns for path in tmp_path.glob("0*.tar")}
    assert len(finished) > 2
    for _ in range(2):  # the second finds nothing to do
        killed(source, tmp_path, -1)
    assert {path: path.stat().st_mtime_ns for path in finished} == finished, "a finished shard was written again"
    kept = sorted(path.name for path in (packed / "scenes").iterdir())
    assert sorted(path.name for path in tmp_path.iterdir()) == kept
    assert all((tmp_path / name).read_bytes() == (packed / "scenes" / name).read_bytes() for name in kept)
    with pytest.raises(UserError, match="holds shards of other samples or options"):
        pack(source, tmp_path, options={"short_side": 28})


def cut(path):
    path.write_bytes(path.read_bytes()[:-700])


def flip(path, at=-3000):
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda root: (root / "000001.tar").unlink(), "a shard is not there.*000001.tar"),
        (lambda root: cut(root / "000002.tar"), r"000002.tar has [\d,]+ bytes of [\d,]+; copy it again"),
        (lambda root: (root / "index.json").unlink(), "no .*index.json"),
        (lambda root: (root / "index.json").write_text("{"), "index.json"),
        (lambda root: (root / "index.npy").unlink(), "no .*index.npy"),
        (lambda root: flip(root / "index.npy", -1), "index.npy does not belong to index.json"),
    ],
)
def test_a_copy_that_is_not_whole_is_refused_in_a_line(copy, harm, told):
    harm(copy)
    for read in (lambda: ShardScenes(root=str(copy)), lambda: Data()(["check", str(copy), "--min-views", "1"])):
        with pytest.raises(UserError, match=told):
            read()
    with pytest.raises(UserError, match=r"index.json|shards of scenes"):
        ShardStyles(root=str(copy))


def test_a_damaged_sample_is_skipped_by_a_training_and_found_by_a_check(copy, packed, caplog, capsys):
    flip(copy / "000001.tar")
    scenes = batches(ShardScenes(root=str(copy)), ShardStyles(root=str(packed / "styles")))
    with caplog.at_level(logging.WARNING):
        for step in range(8):
            scenes.batch(step)
    assert any("000001.tar" in line and "the shard is damaged" in line for line in caplog.messages)
    with pytest.raises(UserError, match=r"1 samples of .* are damaged"):
        Data()(["check", str(copy)])
    told = capsys.readouterr().out
    assert "000001.tar, " in told and "the shard is damaged" in told


def test_the_command_packs_the_words_of_a_training_and_says_the_next(folder, tmp_path, capsys):
    words = ["scenes=folder", f"scenes.root={folder / 'scenes'}", "scenes.short_side=42", "styles=folder"]
    words += [f"styles.root={folder / 'styles'}", "styles.size=14"]
    Data()(["shard", str(tmp_path / "out"), *words, "--megabytes", "2"])
    told = capsys.readouterr().out
    assert f"scenes    {SCENES + 2} in 3 shards" in told and "styles    3 in 1 shards" in told
    config = compose("train", [*told.split("anystyle train ")[1].split(), "name=x", "out=y"])
    scenes, styles = build(SceneSource, config.scenes), build(StyleSource, config.styles)
    same_views(scenes.read(0, [0]), FolderScenes(root=words[1].partition("=")[2], short_side=42).read(0, [0]))
    assert styles.read(1).text == ("grün, coarse",) and styles.read(1).image.shape[-1] == 14
    Data()(["check", str(tmp_path / "out" / "scenes")])
    told = capsys.readouterr().out
    assert "layout    scenes in 3 shards" in told and "cameras   12" in told and "truncated" in told
    assert f"{SCENES + 1} that can be used, of {SCENES + 2}" in told
    Data()(["check", str(tmp_path / "out" / "styles"), "--headers"])
    assert "texts     1" in capsys.readouterr().out
    with pytest.raises(UserError, match="in the words of a training"):
        Data()(["shard", str(tmp_path / "none")])
    with pytest.raises(UserError, match="ToyScenes makes its pictures"):
        pack(ToyScenes(), tmp_path / "none", options={})
    assert not (tmp_path / "none").exists()
