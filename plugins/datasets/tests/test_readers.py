"""RealEstate10K in chunks, and WikiArt with its descriptions."""

import io
import json

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import WikiArtStyles
from tests.support.pictures import picture


def test_a_clip_of_any_name_is_written_nowhere(tmp_path, monkeypatch):
    data, inside = tmp_path / "data", tmp_path / "temporary" / "deep"
    data.mkdir()
    inside.mkdir(parents=True)
    monkeypatch.setattr("tempfile.tempdir", str(inside))
    Re10kScenes.example(data)
    key = "../../outside"
    clips = torch.load(data / "train" / "0.torch", weights_only=True)
    torch.save([clips[0] | {"key": key}], data / "train" / "0.torch")
    (data / "train" / "index.json").write_text(json.dumps({key: "0.torch"}))
    before = set(tmp_path.rglob("*"))
    names = Re10kScenes(root=str(data), short_side=28).read(0, [0, 1]).names
    assert names == ("______outside_00000", "______outside_00001")
    assert set(tmp_path.rglob("*")) == before


def test_re10k_chunks(tmp_path):
    folder = tmp_path / "train"
    folder.mkdir()
    buffer = io.BytesIO()
    Image.new("RGB", (64, 36), (10, 200, 30)).save(buffer, "PNG")
    image = torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8)
    camera_from_world = np.concatenate([Rotation.from_rotvec([0, 0.3, 0]).as_matrix(), [[1.0], [2], [3]]], axis=1)
    row = torch.tensor([0.8, 1.4, 0.5, 0.5, 0, 0, *camera_from_world.ravel()], dtype=torch.float32)
    clip = {"key": "abc", "url": "u", "cameras": row.repeat(3, 1), "images": [image] * 3}
    torch.save([clip], folder / "000000.torch")
    (folder / "index.json").write_text(json.dumps({"abc": "000000.torch", "lost": "000001.torch", "up": "../x"}))
    scenes = Re10kScenes(root=str(tmp_path), short_side=28, multiple=14)
    assert scenes.name(0) == "abc" and scenes.num_views(0) == 3
    views = scenes.read(0, [0, 2])
    assert views.size == (28, 56) and views.names == ("abc_00000", "abc_00002")
    np.testing.assert_allclose(views.cameras.camera_from_world[0, 1, :3], camera_from_world, atol=1e-5)
    # 64 x 36 is cut to 64 x 32 and scaled by 7/8; the principal point stays in the middle.
    expected = torch.tensor([[0.8 * 56, 0, 28], [0, 1.4 * 36 * 7 / 8, 14], [0, 0, 1]])
    torch.testing.assert_close(views.cameras.intrinsics[0, 0], expected)
    for scene, told in ((1, "not there"), (2, "outside")):
        with pytest.raises(ValueError, match=told):
            scenes.num_views(scene)
    for content in (b"nonsense", b"\x80\x02cos\nsystem\nX\x01\x00\x00\x00x\x85R."):  # a pickle that would run a program
        (folder / "000001.torch").write_bytes(content)
        with pytest.raises(ValueError, match="chunk of clips"):
            scenes.num_views(1)
    with pytest.raises(ValueError, match="no JSON object from clips"):
        Re10kScenes(root=str(tmp_path), split="test")


@pytest.fixture
def gallery(tmp_path):
    for name, shade in (("Pop_Art/a.jpg", 50), ("Pop_Art/b.png", 100), ("Late_Renaissance/x/c.jpeg", 150)):
        picture(tmp_path / name, shade, (60, 40))
    (tmp_path / "Pop_Art" / "broken.jpg").write_text("nonsense")
    (tmp_path / "wikiarts_descriptions.txt").write_text(
        "Pop_Art/a.jpg;bold outlines; flat colour\nGone/z.jpg;hazy blue\nGone/y.jpg;\nGone/w.jpg;golden light\n"
    )
    (tmp_path / "wikiarts_test_files.txt").write_text("Pop_Art/b.png\n")
    return tmp_path


def test_wikiart_descriptions_folders_splits_and_texts_alone(gallery, caplog):
    styles = WikiArtStyles(root=str(gallery), size=32)
    assert "1 of 3 pictures cannot be read" in caplog.text and "broken.jpg" in caplog.text
    read = [styles.read(style) for style in range(len(styles))]
    assert [style.text[0] for style in read] == ["x", "bold outlines; flat colour", "hazy blue", "golden light"]
    assert [style.image is None for style in read] == [False, False, True, True]
    assert read[1].image.shape == (1, 3, 32, 32) and read[1].image.mean().item() * 255 == pytest.approx(50, abs=1)
    assert [style.names[0] for style in read] == ["c", "a", "z", "w"]
    # As published, so many first descriptions are searched, present paintings among them.
    assert len(WikiArtStyles(root=str(gallery), text_only=1)) == 2
    assert len(WikiArtStyles(root=str(gallery), text_only=2)) == 3
    test = WikiArtStyles(root=str(gallery), split="test")
    assert [test.read(style).text for style in range(len(test))] == [("Pop Art",)]
    assert len(WikiArtStyles(root=str(gallery), split="all", text_only=0)) == 3


def test_a_painting_that_turns_out_damaged_is_named_and_never_replaced_in_silence(gallery):
    noise = np.random.default_rng(0).integers(0, 255, (200, 200, 3), dtype=np.uint8)
    Image.fromarray(noise).save(gallery / "Pop_Art" / "a.jpg")
    data = (gallery / "Pop_Art" / "a.jpg").read_bytes()
    (gallery / "Pop_Art" / "a.jpg").write_bytes(data[: len(data) // 2])
    styles = WikiArtStyles(root=str(gallery), size=32, text_only=0)
    with pytest.raises(ValueError, match=r"a\.jpg is a damaged image"):
        styles.read(1)
    assert styles.read(0).names == ("c",)


def test_bad_galleries(tmp_path, gallery):
    with pytest.raises(ValueError, match="no such folder"):
        WikiArtStyles(root=str(tmp_path / "absent"))
    (tmp_path / "nothing").mkdir()
    with pytest.raises(ValueError, match="no paintings"):
        WikiArtStyles(root=str(tmp_path / "nothing"))
    with pytest.raises(ValueError, match="no file of captions"):
        WikiArtStyles(root=str(gallery), descriptions=str(tmp_path / "absent.txt"))
    with pytest.raises(ValueError, match="no list of paintings"):
        WikiArtStyles(root=str(gallery), test_files=str(tmp_path / "absent.txt"))
