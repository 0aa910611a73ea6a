"""Describing paintings, with a stand-in for the model."""

import json

import pytest
from PIL import Image

from anystyle.data.style_folder import FolderStyles
from anystyle_datasets.captioning import caption_folder, transformers_captioner
from anystyle_datasets.wikiart import DESCRIPTIONS, WikiArtStyles


class Shades:
    """Says how bright a picture is."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def __call__(self, pictures, prompt):
        self.asked.append(len(pictures))
        assert all(picture.size == (224, 224) and picture.mode == "RGB" for picture in pictures)
        return [f"shade {picture.getpixel((5, 5))[0]};\n {prompt}" for picture in pictures]


@pytest.fixture
def paintings(tmp_path):
    (tmp_path / "Op_Art").mkdir()
    for number in range(5):
        Image.new("RGB", (30, 20), (10 * number,) * 3).save(tmp_path / "Op_Art" / f"{number}.png")
    (tmp_path / "Op_Art" / "torn.png").write_bytes(b"nothing")
    return tmp_path


def test_the_file_is_what_the_style_sources_read(paintings):
    failed = caption_folder(paintings, Shades(), out=paintings / DESCRIPTIONS, prompt="how", batch=2)
    assert list(failed) == ["Op_Art/torn.png"]
    styles = WikiArtStyles(root=str(paintings), size=8)
    assert [styles.read(place).text for place in range(5)] == [(f"shade {10 * place}, how",) for place in range(5)]
    caption_folder(paintings / "Op_Art", Shades(), out=paintings / "Op_Art" / "captions.jsonl", prompt="how")
    assert FolderStyles(root=str(paintings / "Op_Art"), size=8).read(3).text == ("shade 30, how",)


def test_an_interrupted_run_goes_on_where_it_was(paintings):
    out = paintings / "captions.jsonl"

    class Breaks(Shades):
        def __call__(self, pictures, prompt):
            if self.asked:
                raise RuntimeError("out of memory")
            return super().__call__(pictures, prompt)

    with pytest.raises(RuntimeError):
        caption_folder(paintings, Breaks(), out=out, batch=2)
    assert len(out.read_text().splitlines()) == 2
    model, told = Shades(), []
    caption_folder(paintings, model, out=out, batch=2, progress=lambda *where: told.append(where))
    assert model.asked == [2, 1] and told[-1] == (6, 6)
    assert [json.loads(line)["image"] for line in out.read_text().splitlines()] == [f"Op_Art/{n}.png" for n in range(5)]


def test_a_model_that_answers_amiss_is_refused(paintings, tmp_path):
    with pytest.raises(ValueError, match="0 texts for 5 pictures"):
        caption_folder(paintings, lambda pictures, prompt: [], out=tmp_path / "c.jsonl", batch=9)
    with pytest.raises(ValueError, match="no pictures below"):
        caption_folder(paintings / "none", Shades(), out=tmp_path / "c.jsonl")


def test_the_extra_is_named_where_the_library_is_missing(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "transformers", None)
    with pytest.raises(ImportError, match=r'pip install "anystyle\[captions\]"'):
        transformers_captioner("any", "cpu")
