"""What a source of styles promises: see :class:`anystyle.contracts.StyleSource`."""

from torch import Tensor

from anystyle.contracts import StyleSource
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.comparing import MOST, conform, copies, expect_any, expect_finite, expect_same, expect_srgb
from anystyle.testing.subject import Subject
from anystyle.types import Style

Plugin = Subject[StyleSource]


def styles_have_an_image_or_a_text(plugin: Plugin) -> None:
    """Each style is a batch of one on the CPU: an image in [0, 1], a text, or both; all images have one size."""
    source = plugin.instance
    expect_any(source, "style")
    sizes: set[tuple[int, ...]] = set()
    for index in range(min(len(source), MOST)):
        with attempt(f"reading style {index}", change="see the line named above"):
            style = source.read(index)
        where = f"style {index}"
        conform(style, Style, where, B=1)
        expect_finite(style, where)
        texts = [text for text in style.text or () if text]
        expect(
            style.image is not None or len(texts) == 1,
            given=f"{where} with neither image nor text" if not texts else f"{where} with {len(texts)} texts",
            change="leave out styles that have neither",
        )
        if style.image is not None:
            expect_srgb(style.image, where)
            sizes.add(tuple(style.image.shape))
    expect(
        len(sizes) <= 1, given=f"images of sizes {sorted(sizes)}", change="resize and crop to a size that is an option"
    )


def reading_twice_is_the_same(plugin: Plugin) -> None:
    """A style is the same bits whatever was read before, in this process or in a worker's copy."""
    source = plugin.instance
    first = source.read(0)
    kept = first.map(Tensor.clone)
    source.read(len(source) - 1)
    for what, again in copies(plugin):
        style = again.read(0)
        change = "seed a generator with the style's number, and cache nothing that is changed later"
        expect_same(style, kept, what=f"style 0 read again from {what}", change=change)
        expect(
            style.text == first.text and style.names == first.names,
            given=f"text {style.text} and names {style.names} from {what}",
            expected=f"{first.text} and {first.names}, as at first",
            change=change,
        )


CHECKS: tuple[Check, ...] = (Check(styles_have_an_image_or_a_text, needed=True), Check(reading_twice_is_the_same))
