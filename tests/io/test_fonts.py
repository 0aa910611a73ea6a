"""Titles in scripts of the world are legible where DejaVu Sans has them, and no letter is an empty box."""

import logging
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

from anystyle.io import fonts
from anystyle.io.sheet import contact_sheet

DEJAVU = str(Path(mpl.get_data_path()) / "fonts/ttf/DejaVuSans.ttf")


@pytest.fixture(autouse=True)
def forgotten():
    for function in (fonts._fonts, fonts._tell):
        function.cache_clear()
    yield
    for function in (fonts._fonts, fonts._tell):
        function.cache_clear()


def drawn(text, font):
    image = Image.new("L", (200, 30))
    ImageDraw.Draw(image).text((2, 2), text, fill=255, font=font)
    return np.asarray(image)


def test_plain_text_is_in_pillows_own_font():
    text, font = fonts.lettered("The Great Wave, 1831", 15)
    assert text == "The Great Wave, 1831" and font.getname() == ImageFont.load_default(15).getname()


@pytest.mark.parametrize("text", ["Gemälde für Zoë", "Звёздная ночь", "ليلة النجوم", "Νύχτα"])
def test_letters_of_other_scripts_are_drawn_as_another_reader_of_the_font_draws_them(text, caplog):
    shown, font = fonts.lettered(text, 15)
    assert shown == text and not caplog.messages
    assert np.array_equal(drawn(shown, font), drawn(text, ImageFont.truetype(DEJAVU, 15)))


def test_letters_that_no_font_has_are_left_out_and_told_of_once(monkeypatch, caplog):
    texts = ("🌊 wave 梵高", "梵高的星空", "नीली wave")  # the vowels of the last are marks of letters that are left out
    assert [fonts.lettered(text, 15)[0] for text in texts] == ["wave", "?", "wave"]
    with caplog.at_level(logging.WARNING):
        contact_sheet([[None]], column_titles=["🌊梵"])
    assert len(caplog.messages) == 1 and "report.json has the titles whole" in caplog.text
    monkeypatch.setattr(fonts, "find_spec", lambda name: None)
    fonts._fonts.cache_clear()
    assert fonts.lettered("Gemälde", 15)[0] == "Gemalde"
