"""The selection test of perceptual networks: does it tell one that sees patterns from one that does not?"""

from pathlib import Path

import pytest
import torch

from anystyle import perception
from anystyle.evaluation.protocols.pixels import Pixels
from anystyle.perception.features import RGB
from anystyle.perception.pixels import coarse_luma, optimise_pixels, patch_distance


def stripes(size: int, period: int) -> torch.Tensor:
    dark = (torch.arange(size) // period % 2).float()
    return (0.2 + 0.6 * dark).expand(1, 3, size, size).contiguous()


def test_patches_know_a_texture_and_not_its_place():
    coarse, fine = stripes(48, 6), stripes(48, 2)
    assert float(patch_distance(coarse, coarse.roll(4, -1))) < 0.5 * float(patch_distance(coarse, fine))
    assert float(patch_distance(coarse, coarse + 0.1)) == pytest.approx(0.0, abs=1e-6)


def test_coarse_luma_ignores_brightness_and_contrast():
    image = torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(0)).repeat_interleave(8, 2)
    image = image.repeat_interleave(8, 3)
    assert torch.allclose(coarse_luma(image), coarse_luma(0.3 + 0.5 * image), atol=2e-3)


def test_a_network_that_knows_textures_paints_them_and_colours_alone_do_not():
    content = torch.rand(1, 3, 6, 6, generator=torch.Generator().manual_seed(1))
    content = torch.nn.functional.interpolate(content, size=(32, 32), mode="bilinear")
    style, network = stripes(32, 4), perception.load("texture")
    start = float(patch_distance(content, style))
    left = {
        name: float(patch_distance(optimise_pixels(content, style, network, steps=30, layers=layers), style)) / start
        for name, layers in (("texture", (RGB, "relu1_1", "relu2_1", "relu3_1")), ("colours", (RGB,)))
    }
    assert left["texture"] < 0.85 and left["texture"] < 0.8 * left["colours"], left


def test_without_a_style_weight_the_content_stays():
    content = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(2))
    network = perception.load("texture")
    kept = optimise_pixels(content, stripes(32, 4), network, steps=3, style_weight=0.0, layers=(RGB,))
    assert torch.allclose(kept, content, atol=1e-2)


def test_the_sheet_is_written_and_what_was_made_is_not_made_again(tmp_path: Path):
    protocol = Pixels(networks=("untrained",), patterns=("dots",), steps=2, size=32)
    told: list[int] = []
    found = protocol.run(tmp_path, lambda stage, done, total: told.append(done))
    assert (tmp_path / "sheets" / "sheet.png").is_file() and told == [0, 1, 2]
    told.clear()
    assert protocol.run(tmp_path, lambda stage, done, total: told.append(done)).figures == found.figures
    assert told == [2]
    with pytest.raises(ValueError, match="networks are \\['nothing'\\]; choose from untrained, "):
        Pixels(networks=("nothing",))
