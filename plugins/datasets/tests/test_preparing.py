"""A miniature of each data set as its publisher hands it out: prepared, checked and trained on by commands alone."""

import json
import re
import shlex
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.errors import UserError
from anystyle.evaluation.paper_folder import NUM_FRAMES, NUM_STYLES, SCENES, PaperFolder
from anystyle.io.video import write_video
from anystyle.testing.oracle import hashed
from anystyle_datasets import preparing
from anystyle_datasets.command import Data
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import DESCRIPTIONS, TEST_FILES, WikiArtStyles

HASHES = [f"{number:x}" * 64 for number in range(1, 4)]


def picture(path, seed=0, size=(64, 48)):
    path.parent.mkdir(parents=True, exist_ok=True)
    levels = (hashed(seed, (3, size[1] // 8, size[0] // 8)) * 255).byte().permute(1, 2, 0).numpy()
    Image.fromarray(levels).resize(size, Image.Resampling.BICUBIC).save(path)


def contents(folder):
    """Each file with its content and its time: equal where nothing was done."""
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def say(capsys):
    """Types words behind ``anystyle data``; the result is what is said and the command that is said to be next."""

    def call(*words):
        Data()([str(word) for word in words])
        out = capsys.readouterr().out
        return out, re.findall(r"next      anystyle (.*)", out)[-1]

    return call


def dl3dv_scene(folder, seed=0):
    frames = []
    for number in range(7):
        picture(folder / "images_8" / f"frame_{number:05d}.png", seed=seed + number)
        pose = np.eye(4)
        pose[0, 3] = 0.1 * number
        frames.append({"file_path": f"images/frame_{number:05d}.png", "transform_matrix": pose.tolist()})
    content = {"w": 64, "h": 48, "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))


@pytest.fixture
def dl3dv(tmp_path):
    """Two subsets: a scene that is unpacked, and one as the hub has it."""
    root = tmp_path / "DL3DV-10K"
    dl3dv_scene(root / "1K" / HASHES[0])
    dl3dv_scene(tmp_path / "packed" / HASHES[1], seed=10)
    (root / "2K").mkdir()
    with zipfile.ZipFile(root / "2K" / f"{HASHES[1]}.zip", "w") as archive:
        for path in sorted((tmp_path / "packed").rglob("*.*")):
            archive.write(path, path.relative_to(tmp_path / "packed"))
    return root


@pytest.fixture
def wikiart(tmp_path):
    """As its archive unpacks: movements in a folder that is alone in another."""
    root = tmp_path / "archive" / "wikiart"
    for number, name in enumerate(("Cubism/painter_a-1911.jpg", "Cubism/painter_b-1912.jpg", "Ukiyo_e/other_c.jpg")):
        picture(root / name, seed=20 + number)
    return root


def test_dl3dv_is_unpacked_and_indexed_once(dl3dv, say):
    out, following = say("check", dl3dv)
    assert "1 scenes are packed" in out and "train_index.json is not there" in out and "1 that can be used" in out
    assert following == f"data prepare dl3dv {dl3dv}"
    out, following = say(*shlex.split(following)[1:])
    names = [f"1K/{HASHES[0]}", f"2K/{HASHES[1]}"]
    assert json.loads((dl3dv / "train_index.json").read_text()) == names
    before = contents(dl3dv)
    assert say("prepare", "dl3dv", dl3dv)[0] == out and contents(dl3dv) == before
    out, following = say(*shlex.split(following)[1:])
    assert "2 that can be used, of 2, 7 views each" in out and "problems  0" in out
    assert following == f"train experiment=paper_head scenes=dl3dv scenes.root={dl3dv}"
    # Scenes of the test index stay out.
    (dl3dv / "test_index.json").write_text(json.dumps(names[:1]))
    say("prepare", "dl3dv", dl3dv)
    assert json.loads((dl3dv / "train_index.json").read_text()) == names[1:]


def test_dl3dv_is_recognised_flat_and_a_torn_archive_leaves_nothing(dl3dv, say):
    assert say("check", dl3dv / "1K")[1] == f"data prepare dl3dv {dl3dv / '1K'}"
    say("prepare", "dl3dv", dl3dv / "1K")
    assert json.loads((dl3dv / "1K" / "train_index.json").read_text()) == [HASHES[0]]
    archive = dl3dv / "2K" / f"{HASHES[1]}.zip"
    archive.write_bytes(archive.read_bytes()[:3000])
    with pytest.raises(UserError, match="is not an archive, or is damaged"):
        Data()(["prepare", "dl3dv", str(dl3dv)])
    assert list(archive.parent.iterdir()) == [archive]
    with pytest.raises(UserError, match="holds no scene of DL3DV"):
        Data()(["prepare", "dl3dv", str(dl3dv.parent / "packed" / HASHES[1])])


TIMES = [1_000_000 + 40_000 * number for number in range(8)]


def camera_list(path, address):
    path.parent.mkdir(parents=True, exist_ok=True)
    row = "0.9 1.6 0.5 0.5 0 0 1 0 0 {} 0 1 0 0 0 0 1 0"
    lines = [f"{time} {row.format(0.1 * number)}" for number, time in enumerate(TIMES)]
    path.write_text("\n".join([address, *lines]))


@pytest.fixture
def re10k(tmp_path):
    """Three camera lists: one with frames, one with a video, one with neither."""
    root = tmp_path / "RealEstate10K"
    for number, key in enumerate(("aa", "bb", "cc")):
        camera_list(root / "train" / f"{key}.txt", f"https://www.youtube.com/watch?v=ID{number}")
    for number, time in enumerate(TIMES):
        picture(root / "frames" / "train" / "aa" / f"{time}.png", seed=number)
    # Frame n, at n / 25 s, has the shade 3n: TIMES are those of frames 25 to 32.
    shades = (torch.full((3, 36, 64), 3 * number / 255) for number in range(40))
    (root / "videos").mkdir()
    write_video(shades, root / "videos" / "ID1.mp4", fps=25)
    return root


def test_frames_of_realestate_become_chunks_once(re10k, say, monkeypatch):
    out, following = say("check", re10k)
    assert "train: 3 of 3 camera lists are in no chunk" in out and following == f"data prepare re10k {re10k}"
    monkeypatch.setattr(preparing, "CHUNK", 1)  # a chunk for each clip
    out, following = say(*shlex.split(following)[1:])
    assert "train: 2 of 3 clips, 1 without frames here" in out
    scenes = Re10kScenes(root=str(re10k), short_side=28)
    assert scenes.keys == ["aa", "bb"] and scenes.num_views(0) == scenes.num_views(1) == 8
    assert scenes.frames(0)[0] == (re10k / "frames" / "train" / "aa" / f"{TIMES[0]}.png").read_bytes()
    film = scenes.read(1, [0, 7])
    shown = (film.images.mean(dim=(0, 2, 3, 4)) * 255).tolist()
    assert shown == pytest.approx([3 * 25, 3 * 32], abs=1.5)
    assert film.cameras.world_from_camera[0, 1, 0, 3].item() == pytest.approx(-0.7)
    before = contents(re10k)
    say("prepare", "re10k", re10k)
    assert contents(re10k) == before
    out, following = say("check", re10k)
    assert "train: 1 of 3 camera lists are in no chunk" in out and following.startswith("train ")
    picture(re10k / "frames" / "cc" / f"{TIMES[0]}.jpg", size=(1280, 720))
    picture(re10k / "frames" / "cc" / f"{TIMES[5]}.jpg", size=(1280, 720))
    _, following = say("prepare", "re10k", re10k)
    out, following = say(*shlex.split(following)[1:])
    assert "2 of 640 x 360" in out and "problems  0" in out
    use = f"scenes=re10k scenes.root={re10k} scenes.short_side=360 scenes.multiple=1"
    assert following == f"train experiment=paper_head {use}"
    # A torn video leaves its clip out, and no chunk is written over.
    (re10k / "videos" / "ID3.mp4").write_bytes((re10k / "videos" / "ID1.mp4").read_bytes()[:1500])
    camera_list(re10k / "train" / "dd.txt", "https://www.youtube.com/watch?v=ID3")
    before = contents(re10k)
    assert "train: 3 of 4 clips, 1 without frames here" in say("prepare", "re10k", re10k)[0]
    assert contents(re10k) == before
    (re10k / "train" / "dd.txt").write_text("address\n1 2 3\n")
    with pytest.raises(UserError, match=r"dd\.txt is not a camera list of RealEstate10K"):
        Data()(["prepare", "re10k", str(re10k)])


def evaluation_archive(path, folder="splits"):
    """As the authors' archive is described: descriptions, the list of test styles, scenes and styles of the tables."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{folder}/{DESCRIPTIONS}", "Cubism\\painter_a-1911.jpg;grey planes\nGone/z.jpg;gold; haze\n")
        archive.writestr(f"{folder}/{TEST_FILES}", "Cubism\\painter_b-1912.jpg\n")
        archive.writestr("__MACOSX/style_descriptions.txt", "nothing")
        archive.writestr("stylos_evaluation_data/style_descriptions.txt", "00.jpg;thick; blue\n01.jpg;thin lines\n")
        names = [*(f"content/Train/{frame}.png" for frame in range(9)), "style_images/00.jpg", "style_images/01.jpg"]
        for seed, name in enumerate(names):
            picture(path.parent / "made.png", seed=seed)
            archive.write(path.parent / "made.png", f"stylos_evaluation_data/{name}")
    return path


def test_wikiart_is_recognised_before_it_has_captions(wikiart, tmp_path, say):
    out, following = say("check", wikiart.parent)
    assert "layout    wikiart" in out and "images    3\n" in out
    assert following == f"data caption {wikiart} --trust-remote-code"
    archive = evaluation_archive(tmp_path / "evaluation_and_splits.zip")
    # The folder that the archive unpacks to will do, too.
    out, following = say("prepare", "wikiart", wikiart.parent, "--archive", archive)
    assert f"taken from the archive: {DESCRIPTIONS}, {TEST_FILES}; 1 test styles" in out
    before = contents(wikiart)
    say("prepare", "wikiart", wikiart, "--archive", archive)
    assert contents(wikiart) == before
    out, following = say(*shlex.split(following)[1:])
    assert "texts     1\n" in out and following == f"train experiment=paper_head styles=wikiart styles.root={wikiart}"
    styles = WikiArtStyles(root=str(wikiart), size=8)
    assert styles.read(0).text == ("grey planes",)
    assert [path.name for path in styles.paths] == ["painter_a-1911.jpg", "other_c.jpg"]
    assert styles.read(2).text == ("gold; haze",)


def test_tables_of_paintings_become_folders_of_movements(tmp_path, say, monkeypatch):
    root = tmp_path / "wikiart"
    (root / "data").mkdir(parents=True)
    (root / "data" / "train-00000-of-00001.parquet").write_bytes(b"")
    assert say("check", root)[1] == f"data prepare wikiart {root}"
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "pyarrow", None)
        with pytest.raises(ImportError, match=r'pip install "anystyle\[parquet\]"'):
            Data()(["prepare", "wikiart", str(root)])
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    with pytest.raises(UserError, match="is not a parquet file, or is damaged"):
        Data()(["prepare", "wikiart", str(root)])
    picture(tmp_path / "one.jpg")
    image = {"bytes": (tmp_path / "one.jpg").read_bytes(), "path": None}
    names = {"artist": {"names": ["claude-monet"]}, "style": {"names": ["Cubism", "Impressionism"]}}
    columns = {"image": [image, image | {"path": "a/own.jpg"}], "artist": [0, 0], "style": [1, 0]}
    about = {"huggingface": json.dumps({"info": {"features": names}})}
    table = pyarrow.table(columns).replace_schema_metadata(about)
    parquet.write_table(table, root / "data" / "train-00000-of-00001.parquet")
    _, following = say("prepare", "wikiart", root)
    before = contents(root)
    say("prepare", "wikiart", root)
    assert contents(root) == before
    paintings = sorted(path.relative_to(root).as_posix() for path in root.rglob("*.jpg"))
    assert paintings == ["Cubism/own.jpg", "Impressionism/claude-monet_train-00000-of-00001-0-0.jpg"]
    assert "images    2\n" in say(*shlex.split(following)[1:])[0]


def test_each_set_of_test_styles_is_one_option(wikiart, tmp_path, say):
    with Image.open(wikiart / "Ukiyo_e" / "other_c.jpg") as image:
        (tmp_path / "styles").mkdir()
        image.resize((90, 70)).save(tmp_path / "styles" / "00.png")
    (tmp_path / "styl3r").mkdir()
    (tmp_path / "styl3r" / "abstract_1.jpg").write_bytes((wikiart / "Cubism" / "painter_b-1912.jpg").read_bytes())
    assert "; 1 test styles" in say("prepare", "wikiart", wikiart, "--stylos", tmp_path / "styles")[0]
    assert (wikiart / TEST_FILES).read_text() == "Ukiyo_e/other_c.jpg\n"
    assert "; 2 test styles" in say("prepare", "wikiart", wikiart, "--styl3r", tmp_path / "styl3r")[0]
    assert [path.name for path in WikiArtStyles(root=str(wikiart)).paths] == ["painter_a-1911.jpg"]
    assert len(WikiArtStyles(root=str(wikiart), split="test", text_only=0)) == 2
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"--captures is for tables, not for wikiart"):
        Data()(["prepare", "wikiart", str(wikiart), "--captures", str(tmp_path)])
    with pytest.raises(UserError, match=r"--styl3r .*gone: that is not there"):
        Data()(["prepare", "wikiart", str(wikiart), "--styl3r", str(tmp_path / "gone")])


def test_a_folder_of_styles_gets_lines_to_fill_in(tmp_path, say):
    root = tmp_path / "styles"
    for number in range(2):
        picture(root / f"{number:02d}.jpg", seed=number)
    assert say("check", root)[1] == f"data prepare styles {root}"
    assert "0 of 2 pictures have a text" in say("prepare", "styles", root)[0]
    (root / "captions.jsonl").write_text('{"image": "01.jpg", "text": "red waves"}\n')
    assert "1 of 2 pictures have a text" in say("prepare", "styles", root)[0]
    rows = [json.loads(line) for line in (root / "captions.jsonl").read_text().splitlines()]
    assert rows == [{"image": "00.jpg", "text": ""}, {"image": "01.jpg", "text": "red waves"}]
    out, following = say("check", root)
    assert "texts     1\n" in out and following == f"train experiment=paper_head styles=folder styles.root={root}"


SMALL = (
    "model=tiny weights.branch=null trainer=cpu loss.content.network=texture loss.style.network=texture "
    "loss.clip_directional.size=96 loss.clip_patch.size=96 loss.clip_patch.crops=2 training.heights=[112,112] "
    "training.width=112 training.images=4 training.context_views=[2,2] training.spread=any workers=0"
)


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["", "recipe=paper", "recipe=published"])
def test_training_goes_on_where_preparing_ends(dl3dv, re10k, wikiart, tmp_path, say, recipe):
    """Two steps by the words that ``data check`` prints for each kind of scenes and of styles."""
    archive = evaluation_archive(tmp_path / "evaluation_and_splits.zip")
    say("prepare", "wikiart", wikiart, "--archive", archive)
    folder = tmp_path / "styles"
    for number in range(2):
        picture(folder / f"{number}.jpg", seed=number)
    say("prepare", "styles", folder)
    for root, paintings in ({dl3dv: wikiart} if recipe else {dl3dv: wikiart, re10k: folder}).items():
        say("prepare", "re10k" if root == re10k else "dl3dv", root)
        styles, scenes = (shlex.split(say("check", path)[1]) for path in (paintings, root))
        words = [*styles, *scenes[2:], *SMALL.split(), *recipe.split()]
        words += ["trainer.max_steps=2", "name=mini", "resume=never"]
        command = [sys.executable, "-m", "anystyle", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
        assert done.returncode == 0 and "2 steps done" in done.stdout, done.stderr[-1500:]


@pytest.mark.slow
def test_two_tables_come_out_of_the_folder(tmp_path, say):
    """A scene, styles and descriptions of the authors' archive, and a scene of a capture."""
    for frame in range(9):
        picture(tmp_path / "captures" / "garden" / "images" / f"{frame:05d}.jpg", seed=20 + frame)
    archive, root = evaluation_archive(tmp_path / "evaluation_and_splits.zip"), tmp_path / "tables"
    say("prepare", "tables", root, "--archive", archive, "--captures", tmp_path / "captures")
    few = "model=tiny protocol.num_styles=2 protocol.frames=9 protocol.size=56 protocol.scene_names=[Train,Garden]"
    for table in ("table2", "table4"):
        words = ["evaluate", f"protocol={table}", f"root={root}", *few.split(), "--out", table]
        command = [sys.executable, "-m", "anystyle", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
        assert done.returncode == 0, done.stderr[-1500:]
        rows = sorted(path.name for path in (tmp_path / table / "methods").iterdir())
        assert rows == ["model_image", "model_text", "photographs"]


def test_the_folder_of_the_tables_from_captures_or_from_the_archive(tmp_path, say):
    for scene in SCENES:
        for frame in range(NUM_FRAMES):
            picture(tmp_path / "tt" / scene.lower() / "images" / f"{frame:05d}.jpg", seed=frame)
    picture(tmp_path / "tt" / "garden" / "images_4" / "small.jpg")
    for style in range(NUM_STYLES + 1):
        picture(tmp_path / "stylos" / f"{style:02d}.jpg", seed=style)
    root = tmp_path / "tables"
    out, following = say("prepare", "tables", root, "--captures", tmp_path / "tt", "--stylos", tmp_path / "stylos")
    assert out.startswith(f"{len(SCENES) * NUM_FRAMES + NUM_STYLES} files laid out")
    with pytest.raises(UserError, match="styles: no text for 50 styles"):
        Data()(shlex.split(following)[1:])
    (root / "style_descriptions.txt").write_text("".join(f"{style:02d}.jpg;words\n" for style in range(NUM_STYLES)))
    assert say(*shlex.split(following)[1:])[1] == f"evaluate protocol=table2 root={root}"
    archive = evaluation_archive(tmp_path / "evaluation_and_splits.zip")
    say("prepare", "tables", tmp_path / "published", "--archive", archive)
    folder = PaperFolder(tmp_path / "published", ("Train",), num_styles=2, frames=2)
    assert folder.problems() == []
    with pytest.raises(UserError, match="give --archive"):
        Data()(["prepare", "tables", str(tmp_path / "none")])


def test_photographs_of_two_publishers_are_not_mixed(tmp_path, say, caplog):
    archive = evaluation_archive(tmp_path / "evaluation_and_splits.zip")
    root = tmp_path / "tables"
    say("prepare", "tables", root, "--archive", archive)
    before = contents(root)
    for scene in ("Train", "Truck"):
        for frame in range(2):
            picture(tmp_path / "tt" / scene / f"{frame:06d}.jpg", seed=frame)
    say("prepare", "tables", root, "--captures", tmp_path / "tt")
    after = contents(root)
    assert {path.parent.name for path in after.keys() - before.keys()} == {"Truck"}
    assert before.items() <= after.items()
    assert f"{root / 'content' / 'Train'} is kept as it is" in caplog.text
    say("prepare", "tables", tmp_path / "other", "--captures", tmp_path / "tt")
    say("prepare", "tables", tmp_path / "other", "--archive", archive)
    assert len(list((tmp_path / "other" / "content" / "Train").iterdir())) == 2


def test_what_holds_nothing_of_its_kind_is_refused_in_a_line(tmp_path, dl3dv, re10k):
    empty = tmp_path / "empty"
    empty.mkdir()
    other = tmp_path / "other.zip"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("readme.txt", "nothing")
    for name in ("frames", "videos"):
        (re10k / name).rename(tmp_path / name)
    for words, message in {
        ("wikiart", empty): "holds no painting",
        ("wikiart", dl3dv): "holds no painting",
        ("re10k", re10k): "holds no frame of the 3 camera lists",
        ("tables", tmp_path / "t", "--captures", empty): "holds none of Train, Truck, M60, Garden",
        ("tables", tmp_path / "t", "--stylos", empty): "there are no pictures in it",
        ("tables", tmp_path / "t", "--archive", other): "holds none of",
    }.items():
        with pytest.raises(UserError, match=message) as caught:
            Data()(["prepare", *map(str, words)])
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "t").exists() and list(empty.iterdir()) == []


def test_small_photographs_are_better_than_none_and_absent_scenes_are_told(tmp_path, say):
    picture(tmp_path / "360_v2" / "garden" / "images_4" / "small.JPG")
    root = tmp_path / "tables"
    out, _ = say("prepare", "tables", root, "--captures", tmp_path / "360_v2")
    assert out.startswith("1 files laid out; nothing of Train, Truck, M60")
    assert [path.name for path in (root / "content" / "Garden").iterdir()] == ["small.JPG"]
