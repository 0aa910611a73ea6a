"""The procedural styles: pictures that show what their captions say, and combinations that stay apart."""

import re
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle_tiny.procedural.captions import COLORS, MEDIA, SCALES, WORDS
from anystyle_tiny.procedural.patterns import BRUSHWORK, PATTERNS, PRINT
from anystyle_tiny.procedural.styles import ProceduralStyles, is_held_out


def test_combinations_of_the_splits_are_disjoint():
    def combinations(split):
        source = ProceduralStyles(size=8, split=split)
        drawn = (source._draw(style)[1] for style in range(500))
        return {(traits.pattern, frozenset(traits.colors)) for traits in drawn}

    train, validation, heldout = (combinations(split) for split in ("train", "validation", "heldout"))
    assert not heldout & (train | validation) and train & validation
    # One in HOLD combinations, each pattern with many palettes.
    share = np.mean([is_held_out(p, (a, b)) for p, a, b in product(range(len(PATTERNS)), range(9), range(9, 27))])
    assert 0.13 < share < 0.21 and len({pattern for pattern, _ in heldout}) == len(PATTERNS)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 19999), st.sampled_from(["train", "validation", "heldout"]), st.integers(0, 3))
def test_a_caption_names_the_colours_and_the_pattern_and_no_other(style, split, seed):
    source = ProceduralStyles(size=8, split=split, seed=seed)
    text, traits = source.read(style).text[0], source._draw(style)[1]
    pattern = PATTERNS[traits.pattern]
    assert any(noun in text for noun in WORDS[pattern].nouns)
    for color in traits.colors:
        assert any(re.search(rf"\b{name}\b", text) for name in COLORS[color].names)
    words = WORDS[pattern]
    if traits.scale != 0 and not text.startswith(words.nouns):  # "short strokes" are so at any scale
        assert not any(text.startswith(f"{word} ") for word in set(words.fine) - set(words.coarse))
    for brush, phrases in MEDIA.items():
        if any(text.endswith(phrase) for phrase in phrases):
            assert brush == BRUSHWORK[traits.brushwork]
    assert text == text.strip() and "  " not in text and "None" not in text


def test_the_palette_is_what_is_painted():
    """In a crisp print, most pixels lie near a straight line between two colours of the palette or are its shades."""
    source = ProceduralStyles(size=48)
    for style in range(120):
        traits = source._draw(style)[1]
        if traits.brushwork != PRINT:
            continue
        pixels = source.read(style).image[0].flatten(1).T
        hue = torch.nn.functional.normalize(traits.palette, dim=1)
        # Shades change the length of a colour and not its direction; mixtures stay within the palette's span.
        span = torch.linalg.svd(hue, full_matrices=False).Vh[: len(traits.palette)]
        residual = pixels - pixels @ span.T @ span
        assert residual.norm(dim=1).median() < 0.02


def test_scales_change_the_grain():
    """A finer scale has more of its power at high frequencies, whatever the pattern."""
    source = ProceduralStyles(size=48)
    edges = {scale: [] for scale in range(len(SCALES))}
    for style in range(300):
        traits = source._draw(style)[1]
        if PATTERNS[traits.pattern] in ("plain", "wash"):
            continue
        image = source.read(style).image[0]
        edges[traits.scale].append((image.diff(dim=-1).abs().mean() / image.std().clamp_min(0.01)).item())
    fine, medium, coarse = (np.mean(edges[scale]) for scale in range(3))
    assert fine > 1.15 * medium > 1.15**2 * coarse


@pytest.mark.parametrize(
    "options", [{"size": 4}, {"num_styles": 0}, {"max_colors": 4}, {"seed": -1}], ids=lambda o: next(iter(o))
)
def test_options_out_of_range_are_refused(options):
    with pytest.raises(UserError, match=next(iter(options))):
        build(StyleSource, {"_target_": f"{ProceduralStyles.__module__}.ProceduralStyles", **options})


def test_a_style_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="there are 3"):
        ProceduralStyles(num_styles=3).read(3)
