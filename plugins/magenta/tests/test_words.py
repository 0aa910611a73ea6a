"""What the text tower makes of a text before it learns anything."""

import pytest

from anystyle_magenta.words import clean, hash_words
from tests.support.refusals import raises_line


@pytest.mark.parametrize(
    "text",
    [
        "thick, swirling strokes in deep-blue!",
        "THICK SWIRLING STROKES IN DEEP BLUE",
        '  "Thick" (swirling)\n\tstrokes; in: deep_blue.',
        "Thíck swirlïng strokes in déep blue…",
        "𝐭𝐡𝐢𝐜𝐤 swirling strokes in deep blue",
    ],
)
def test_case_accents_and_punctuation_do_not_matter(text: str) -> None:
    assert clean(text) == ["thick", "swirling", "strokes", "in", "deep", "blue"]


def test_a_word_is_its_own_place_and_those_of_its_triples() -> None:
    (blue,) = hash_words("blue", buckets=1 << 20, max_words=4)
    (bluish,) = hash_words("bluish", buckets=1 << 20, max_words=4)
    assert len(blue) == 1 + len("blue")  # <bl blu lue ue>
    assert blue[0] != bluish[0]
    assert set(blue[1:3]) == set(bluish[1:3])  # <bl and blu
    assert not set(blue[3:]) & set(bluish[3:])


def test_places_are_the_same_on_every_machine() -> None:
    (red,) = hash_words("Red", buckets=2048, max_words=4)
    # CRC-32 of "red", "#<re", "#red", "#ed>", modulo the buckets.
    assert red == (1935, 1435, 337, 1295)


@pytest.mark.parametrize("text", ["", "   \n", "!!! --- \"'", "🎨🖌️"])
def test_a_text_without_words_is_refused(text: str) -> None:
    with raises_line(ValueError, match="holds no word"):
        hash_words(text, buckets=64, max_words=8)


def test_a_text_that_is_too_long_is_refused_and_not_quoted_whole() -> None:
    assert len(hash_words("red " * 8, buckets=64, max_words=8)) == 8
    with pytest.raises(ValueError, match=r"has 2000 words, and this encoder reads 8") as caught:
        hash_words("blue " * 2000, buckets=64, max_words=8)
    assert len(str(caught.value)) < 200
