"""Captioned pictures: phrases mean what they say, and pictures are retouched as their words tell."""

import numpy as np
import torch
from kornia.color import rgb_to_grayscale
from PIL import Image

from anystyle.testing.inputs import images
from anystyle_tiny.captioned import CaptionedPictures, gradient_map
from anystyle_tiny.procedural.captions import COLORS
from anystyle_tiny.procedural.layout import Draw
from anystyle_tiny.procedural.phrases import appearances, draw_phrase


def test_a_gradient_map_orders_the_palette_by_the_light_of_the_picture():
    image = images(1, (24, 30), seed=2)
    palette = torch.tensor([[0.9, 0.9, 0.8], [0.1, 0.0, 0.3], [0.6, 0.2, 0.1]])
    result = gradient_map(image, palette)
    order = rgb_to_grayscale(image).flatten().argsort()
    pixels = result.flatten(2)[0].T[order]
    ranks = np.linspace(0, 2, len(order))
    dark_to_light = palette[[1, 2, 0]].numpy()
    expected = np.stack([np.interp(ranks, [0, 1, 2], dark_to_light[:, channel]) for channel in range(3)], axis=1)
    np.testing.assert_allclose(pixels.numpy(), expected, atol=1e-5)


def test_phrases_of_a_thing_are_painted_in_its_colours():
    ocean = next(thing for thing in appearances("things") if thing.words[0] == "ocean")
    texts = set()
    for seed in range(4000):
        text, traits = draw_phrase(Draw((seed,)))
        if text in ocean.words:
            texts.add(text)
            assert set(traits.colors) <= set(ocean.colors) and traits.pattern in ocean.patterns
            for color, rgb in zip(traits.colors, traits.palette, strict=False):
                assert (rgb * 255 - torch.tensor(COLORS[color].rgb)).abs().max() <= 0.035 * 255 + 1e-3
    assert len(texts) >= 2


def test_paintings_with_captions_are_split(tmp_path):
    lines = []
    for index in range(6):
        name = f"{index}.png"
        Image.linear_gradient("L").resize((24, 24)).save(tmp_path / name)
        lines.append(f'{{"image": "{name}", "text": "caption {index}"}}')
    (tmp_path / "captions.jsonl").write_text("\n".join(lines))

    def captions(split):
        source = CaptionedPictures(size=8, num_styles=400, split=split, paintings=str(tmp_path))
        texts = [source.read(index).text[0] for index in range(400)]
        return {text for text in texts if text.startswith("caption")}

    assert captions("train") == {"caption 1", "caption 2", "caption 4", "caption 5"}
    assert captions("heldout") == {"caption 0", "caption 3"}


def test_pictures_are_left_as_they_are_where_nothing_is_to_be_retouched(tmp_path):
    Image.new("RGB", (24, 24), (200, 40, 10)).save(tmp_path / "red.png")
    options = {"size": 8, "num_styles": 60, "paintings": str(tmp_path), "retouch": False}
    for pictures, expected in ((1.0, 60), (0.5, 30), (0.0, 0)):
        source = CaptionedPictures(**options, pictures=pictures)
        styles = [source.read(index) for index in range(60)]
        flat = torch.tensor([200, 40, 10]).view(3, 1, 1) / 255
        shown = [style for style in styles if (style.image[0] - flat).abs().max() < 1e-3]
        assert abs(len(shown) - expected) <= 10 * (0 < pictures < 1)
        assert all(style.text == ("",) for style in shown)
