"""Marks are as wide and as long as they were drawn, and their texture is that of the place which it is taken from."""

import math

import pytest
import torch

from anystyle_methods.flow import blur
from anystyle_methods.marks import REACH, PaintingTexture, marks

SIDE = 256


def dabs(along: float, across: float, angle: float) -> torch.Tensor:
    """Noise, blurred by so many pixels along an angle and across it."""
    frequency = torch.fft.fftfreq(SIDE)
    v, u = torch.meshgrid(frequency, frequency, indexing="ij")
    p, q = math.cos(angle) * u + math.sin(angle) * v, math.cos(angle) * v - math.sin(angle) * u
    noise = torch.randn(SIDE, SIDE, generator=torch.Generator().manual_seed(0))
    kernel = torch.exp(-2 * math.pi**2 * ((along * p).square() + (across * q).square()))
    field = torch.fft.ifft2(torch.fft.fft2(noise) * kernel).real
    return (0.5 + 0.15 * field / field.std()).clamp(0, 1).expand(1, 3, SIDE, SIDE)


@pytest.mark.parametrize(("along", "across"), [(3.0, 1.0), (8.0, 2.0), (6.0, 3.0)])
def test_marks_have_about_the_size_that_they_were_drawn_in(along, across):
    """The autocorrelation of noise blurred by s is exp(-d² / 4s²): a half at 2 s sqrt(ln 2).

    Contours count most, and are narrower than that; the flow follows them, and they are longer.
    """
    full = 4 * math.sqrt(math.log(2))
    one, other = (marks(dabs(along, across, angle), SIDE) for angle in (0.0, 0.7))
    for found in (one, other):
        assert 0.6 < found.width / (full * across) < 1.0 and 1.0 < found.length / (full * along) < 1.9
    assert one.width == pytest.approx(other.width, rel=0.25)


def test_marks_scale_with_their_picture():
    picture = dabs(5.0, 1.5, 0.7)
    whole, half = marks(picture, SIDE), marks(picture, SIDE // 2)
    assert half.length == pytest.approx(whole.length / 2, rel=0.15)


def test_endless_stripes_end_at_the_reach():
    x = torch.arange(SIDE) + 0.5
    found = marks((0.5 + 0.4 * torch.sin(2 * math.pi * x / 12)).expand(1, 3, SIDE, SIDE), SIDE)
    assert found.length == 2 * REACH
    assert found.width == pytest.approx(12 / 3, rel=0.1)  # a cosine is a half after a sixth of its period


def test_an_even_picture_has_marks_of_some_size():
    found = marks(torch.full((1, 3, 64, 64), 0.5), 64)
    assert 0 < found.width <= 2 * REACH and 0 < found.length <= 2 * REACH


def test_texture_is_that_of_places_with_the_same_colour():
    """Rough on the left, which is blue, and smooth on the right, which is orange."""
    generator = torch.Generator().manual_seed(0)
    picture = torch.zeros(1, 3, SIDE, SIDE)
    blue, orange = torch.tensor([0.2, 0.3, 0.8]), torch.tensor([0.9, 0.5, 0.1])
    picture[..., :128] = blue[:, None, None] + 0.1 * torch.randn(SIDE, 128, generator=generator)
    picture[..., 128:] = orange[:, None, None]
    texture = PaintingTexture(picture, SIDE, 4.0, 2.0)
    colors = torch.stack([blue, orange]).repeat_interleave(500, 0)
    found = texture.sample(colors, torch.zeros(1), generator)[0].view(2, 500, 3)
    expected = 2 * (picture - blur(picture, 4.0))[..., 16:112].std()
    assert found[0].std() == pytest.approx(float(expected), rel=0.1)
    assert found[1].abs().mean() < 0.1 * found[0].abs().mean()


def test_offsets_lie_across_the_flow():
    """Across stripes the texture changes with their period, and along them it would not."""
    x = torch.arange(SIDE) + 0.5
    picture = (0.5 + 0.2 * torch.sin(2 * math.pi * x / 8)).expand(1, 3, SIDE, SIDE)
    texture = PaintingTexture(picture, SIDE, 4.0, 1.0)
    found = texture.sample(torch.full((400, 3), 0.5), torch.tensor([0.0, 4.0, 8.0]), torch.Generator().manual_seed(0))
    inner = found[0].abs().mean(1) > 0.05
    assert (found[1] * found[0])[inner].mean() < -0.5 * found[0][inner].square().mean()  # half of a period
    assert (found[2] * found[0])[inner].mean() > 0.5 * found[0][inner].square().mean()
