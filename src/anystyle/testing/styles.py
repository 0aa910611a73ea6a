"""What a source of styles promises: see :class:`anystyle.contracts.StyleSource`."""

from torch import Tensor

from anystyle.contracts import StyleSource
from anystyle.testing import asserts
from anystyle.testing.subject import Subject
from anystyle.types import Style
from anystyle.types.shapes import check_value


def test_styles_have_an_image_or_a_text(plugin: Subject[StyleSource]) -> None:
    """Each style is a batch of one on the CPU: an image in [0, 1], a text, or both; all images have one size."""
    assert len(plugin.instance) >= 1, "no style; override `example`"
    sizes: set[tuple[int, ...]] = set()
    for index in range(min(len(plugin.instance), 3)):
        style, what = plugin.instance.read(index), f"style {index}"
        check_value(style, Style, what, B=1)
        assert style.image is not None or any(style.text or ()), f"{what} has neither an image nor a text"
        if style.image is not None:
            asserts.srgb(style.image, what)
            sizes.add(tuple(style.image.shape))
    assert len(sizes) <= 1, f"images of sizes {sorted(sizes)}; crop them to one"


def test_reading_twice_is_the_same(plugin: Subject[StyleSource]) -> None:
    """A style is the same bits whatever was read before, in this process or in a worker's copy."""
    first = plugin.instance.read(0).map(Tensor.clone)
    plugin.instance.read(len(plugin.instance) - 1)
    for what, source in asserts.copies(plugin):
        style = source.read(0)
        asserts.same(style, first, f"style 0 read again from {what}")
        assert (style.text, style.names) == (first.text, first.names), f"another text or name from {what}"
