"""Texts in the space of Magenta's styles: what they find, what they do not know, and how they mix."""

import json

import pytest
import torch
import torch.nn.functional as F

import anystyle
from anystyle.errors import UserError
from anystyle_magenta import MagentaEncoder
from anystyle_magenta.style_encoder import FILE
from tests.support.refusals import raises_line

NUM_CAPTIONS = 128


@pytest.fixture(scope="module")
def encoder():
    return MagentaEncoder().requires_grad_(False).eval()


def _plugin(kind: str, name: str):
    return anystyle.catalog().find(kind, name).load()


@pytest.mark.slow
def test_captions_find_their_pictures_among_128(encoder):
    styles = _plugin("styles", "procedural")(split="heldout", size=256, num_styles=NUM_CAPTIONS)
    rows = [styles.read(index) for index in range(NUM_CAPTIONS)]
    pictures = torch.cat([encoder.embed_images(row.image) for row in rows])
    captions = encoder.embed_texts([row.text[0] for row in rows])
    pictures, captions = (F.normalize(vectors - vectors.mean(0), dim=-1) for vectors in (pictures, captions))
    cosines = captions @ pictures.T
    nearer = (cosines > cosines.diagonal()[:, None]).sum(1)
    assert (nearer < 1).float().mean() >= 0.65  # by chance 0.01
    assert (nearer < 5).float().mean() >= 0.9


def test_names_of_colours_find_the_colours(encoder):
    colors = {"red": (0.8, 0.1, 0.1), "green": (0.2, 0.6, 0.2), "blue": (0.1, 0.3, 0.8), "yellow": (0.95, 0.85, 0.2),
              "purple": (0.45, 0.2, 0.6), "white": (0.98, 0.98, 0.98), "black": (0.06, 0.06, 0.07)}  # fmt: skip
    pictures = encoder.embed_images(torch.tensor([*colors.values()])[:, :, None, None].expand(-1, 3, 64, 64))
    texts = encoder.embed_texts([f"plain {name}" for name in colors])
    pictures, texts = (F.normalize(vectors - vectors.mean(0), dim=-1) for vectors in (pictures, texts))
    assert torch.equal((texts @ pictures.T).argmax(1), torch.arange(len(colors)))


def test_words_that_were_never_learnt_are_named_and_the_nearest_description_too(encoder):
    match = encoder.match_text("Zebras & blue swirls, by Xyzzy")
    assert match.unknown_words == ("zebras", "xyzzy")
    assert match.description in FILE.read_text().splitlines() and match.similarity < 1
    known = encoder.match_text("Starry night")
    assert known.unknown_words == () and known.description == "starry night"
    assert known.similarity == pytest.approx(1, abs=1e-5)


def test_a_text_of_which_no_word_is_known_is_refused(tmp_path):
    views = _plugin("scenes", "procedural")(split="heldout", size=56).read(11, [0, 1])
    with pytest.raises(UserError, match="knows no word of the text '冬の夜'; say it in English"):
        anystyle.stylize(views, "冬の夜", video={"frames": 2})


def test_the_report_says_what_was_made_of_a_text(tmp_path, caplog):
    views = _plugin("scenes", "procedural")(split="heldout", size=56).read(11, [0, 1])
    (result,) = anystyle.stylize(views, "blue flubber swirls", video={"frames": 2})
    assert "never learnt: flubber" in caplog.text
    anystyle.save(result, tmp_path / "out")
    (text,) = json.loads((tmp_path / "out" / "report.json").read_text())["texts"]
    assert text["text"] == "blue flubber swirls" and text["unknown_words"] == ["flubber"]
    assert text["description"] in FILE.read_text().splitlines() and -1 <= text["similarity"] <= 1


@pytest.mark.parametrize("text", ["", "!?", "blue " * 65])
def test_texts_without_a_word_or_with_too_many_are_refused_in_one_line(encoder, text):
    with raises_line(ValueError, match=r"holds no word|has 65 words"):
        encoder.embed_texts([text])
