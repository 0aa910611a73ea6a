"""Describing paintings, with a stand-in for the model."""

import json
import sys
from types import SimpleNamespace

import pytest
from PIL import Image

from anystyle.data.style_folder import FolderStyles
from anystyle.errors import UserError
from anystyle_datasets.captioning import caption_folder, chat_captioner, transformers_captioner
from anystyle_datasets.command import Data
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
    caption_folder(paintings, model, out=out, batch=2, on_progress=lambda progress: told.append(progress.line))
    assert model.asked == [2, 1] and told[-1] == "describing 6/6"
    assert [json.loads(line)["image"] for line in out.read_text().splitlines()] == [f"Op_Art/{n}.png" for n in range(5)]


def test_a_model_that_answers_amiss_is_refused(paintings, tmp_path):
    with pytest.raises(ValueError, match="0 texts for 5 pictures"):
        caption_folder(paintings, lambda pictures, prompt: [], out=tmp_path / "c.jsonl", batch=9)
    with pytest.raises(ValueError, match="no pictures below"):
        caption_folder(paintings / "none", Shades(), out=tmp_path / "c.jsonl")


@pytest.mark.parametrize("captioner", [transformers_captioner, chat_captioner])
def test_the_extra_is_named_where_the_library_is_missing(monkeypatch, captioner):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ImportError, match=r'pip install "anystyle\[captions\]"'):
        captioner("any", "cpu")


class Loaded:
    """Stands for a model of the transformers library that answers by its page's own code."""

    asked: list

    @classmethod
    def from_pretrained(cls, name, **options):
        assert name == "openbmb/MiniCPM-V-4_5" and options["trust_remote_code"]
        cls.asked = []
        return cls()

    def eval(self):
        return self

    def to(self, device):
        assert device == "cpu"
        return self

    def chat(self, *, msgs, tokenizer, enable_thinking):
        assert isinstance(tokenizer, Loaded) and not enable_thinking
        self.asked.append(msgs)
        return " exact colours;\nthin lines "


def test_the_papers_question_goes_to_the_papers_model_once_its_code_is_allowed(paintings, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "transformers", SimpleNamespace(AutoModel=Loaded, AutoTokenizer=Loaded))
    (paintings / "Op_Art").rename(paintings / "Cubism")
    with pytest.raises(UserError, match=r"runs code that its page brings: allow that by --trust-remote-code, or name"):
        Data()(["caption", str(paintings)])
    Data()(["caption", str(paintings), "--trust-remote-code"])
    assert "left out: Cubism/torn.png" in capsys.readouterr().err
    assert len(Loaded.asked) == 5
    (message,) = Loaded.asked[0]
    picture, question = message["content"]
    assert picture.size == (224, 224) and question.startswith("In 300 chars, give a precise description of image style")
    # The file is the one that styles=wikiart reads.
    assert (paintings / DESCRIPTIONS).read_text().splitlines()[0] == "Cubism/0.png;exact colours, thin lines"
