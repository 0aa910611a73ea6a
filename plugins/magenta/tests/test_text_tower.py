"""Texts in the space of Magenta's styles: what they find, what they do not know, and how they mix."""

import json

import pytest
import torch
import torch.nn.functional as F

import anystyle
from anystyle.nn.words import clean
from anystyle_magenta import MagentaEncoder
from anystyle_magenta.networks import TextTower
from anystyle_magenta.style_encoder import FILE
from anystyle_magenta.training import CaptionBatches, recall
from anystyle_tiny.procedural.captions import COLORS, DIRECTIONS, MEDIA, SCALES, WORDS, describe
from anystyle_tiny.procedural.layout import Draw
from anystyle_tiny.procedural.patterns import BRUSHWORK, PATTERNS
from anystyle_tiny.procedural.phrases import PHOTO_TEXTS, appearances, draw_phrase
from anystyle_tiny.procedural.styles import DIRECTED

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
    assert float(recall(captions, pictures, 1)) >= 0.65  # by chance 0.01
    assert float(recall(captions, pictures, 5)) >= 0.9


def test_a_tower_learns_captions_by_heart():
    styles = _plugin("styles", "captioned")(size=32, num_styles=8)
    encoder = MagentaEncoder().requires_grad_(False).eval()
    batches = CaptionBatches(styles, encoder, seed=0, batch_size=8, pool=None)
    batch = batches.batch(0)
    assert sorted(batch.texts) == sorted(styles.read(index).text[0] for index in range(8))
    torch.manual_seed(0)
    tower = TextTower(width=32, hidden=64)
    tower.fit_axes(batch.vectors)
    optimizer = torch.optim.Adam(tower.parameters(), lr=1e-2)
    for _ in range(60):
        loss = (tower(batch.texts) - batch.vectors).square().sum() / (batch.vectors - tower.mean).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.02
    assert float(recall(tower(batch.texts), batch.vectors, 1)) == 1


def test_pictures_without_captions_teach_nothing(tmp_path):
    folder = _plugin("styles", "folder")
    (tmp_path / "pictures").mkdir()
    options = folder.example(tmp_path / "pictures")
    batches = CaptionBatches(folder(**options), MagentaEncoder(), seed=0, batch_size=2, pool=None)
    with pytest.raises(ValueError, match=r"style 1 lacks a picture or a caption; use styles=captioned"):
        batches.batch(0)


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


def descriptions(num_captions: int = 500) -> tuple[str, ...]:
    """Texts that together have every word of captions and phrases: single words and names, then whole captions."""
    names = [word for group in ("things", "manners", "moods") for each in appearances(group) for word in each.words]
    names += [name for color in COLORS for name in color.names]
    names += [noun for words in WORDS.values() for noun in words.nouns]
    names += [f"{size} {words.nouns[0]}" for words in WORDS.values() for size in words.fine + words.coarse]
    names += [f"{colors} {medium}" for colors in ("red", "blue") for media in MEDIA.values() for medium in media]
    names += PHOTO_TEXTS
    draw = Draw((16,))
    for _ in range(num_captions):
        pattern = PATTERNS[draw.below(len(PATTERNS))]
        colors = tuple(draw.shuffled(range(len(COLORS))))[: 1 + draw.below(3)]
        direction = DIRECTIONS[draw.below(len(DIRECTIONS))] if pattern in DIRECTED else None
        names.append(
            describe(draw, pattern, colors, draw.below(len(SCALES)), BRUSHWORK[draw.below(len(BRUSHWORK))], direction)
        )
    names += [draw_phrase(draw)[0] for _ in range(num_captions)]
    return tuple(dict.fromkeys(names))


def test_the_known_descriptions_are_those_of_the_training_captions():
    assert tuple(FILE.read_text().splitlines()) == descriptions()
    words = {word for text in descriptions() for word in clean(text)}
    source = _plugin("styles", "captioned")(size=8, num_styles=600)
    assert {word for index in range(600) for word in clean(source.read(index).text[0])} <= words


def test_the_report_says_what_was_made_of_a_text(tmp_path, caplog):
    views = _plugin("scenes", "procedural")(split="heldout", size=56).read(11, [0, 1])
    with caplog.at_level("WARNING"):
        (result,) = anystyle.stylize(views, "blue flubber swirls", video={"frames": 2})
    assert "never learnt: flubber" in caplog.text
    anystyle.save(result, tmp_path / "out")
    (text,) = json.loads((tmp_path / "out" / "report.json").read_text())["texts"]
    assert text["text"] == "blue flubber swirls" and text["unknown_words"] == ["flubber"]
    assert text["description"] in FILE.read_text().splitlines() and -1 <= text["similarity"] <= 1


@pytest.mark.parametrize("text", ["", "!?", "blue " * 65])
def test_texts_without_a_word_or_with_too_many_are_refused_in_one_line(encoder, text):
    with pytest.raises(ValueError, match=r"holds no word|has 65 words") as caught:
        encoder.embed_texts([text])
    assert "\n" not in str(caught.value)
