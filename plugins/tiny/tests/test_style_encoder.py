"""The tiny style encoder: texts, gradients, and the colours that it reads."""

import numpy as np
import pytest
import torch

from anystyle.testing.oracle import smooth_image
from anystyle_tiny.style_encoder import COLORS, KNOTS, Tiny, colors, ramp

TEXTS = ("red dots", "thick swirling strokes in deep blue and gold, very large", "a photo", "a")


@pytest.fixture(scope="module")
def encoder() -> Tiny:
    torch.manual_seed(0)
    return Tiny().eval()


def test_a_text_means_the_same_alone_and_in_company(encoder: Tiny) -> None:
    together = encoder.embed_texts(TEXTS)
    alone = torch.cat([encoder.embed_texts([text]) for text in TEXTS])
    torch.testing.assert_close(together, alone, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(together.norm(dim=-1), torch.ones(4))


def test_order_of_words_matters_and_case_does_not(encoder: Tiny) -> None:
    first, second, shouted = encoder.embed_texts(["red dots on blue", "blue dots on red", "RED dots, on BLUE!"])
    torch.testing.assert_close(first, shouted)
    assert (first - second).norm() > 1e-3


def test_gradients_reach_every_pixel_even_of_a_flat_image(encoder: Tiny) -> None:
    images = torch.stack([smooth_image(3, [3, 63, 63]), torch.full((3, 63, 63), 0.5)]).requires_grad_()
    encoder.embed_images(images)[:, :7].sum().backward()
    assert torch.isfinite(images.grad).all() and (images.grad[0].abs().amax(0) > 0).all()


def test_the_palette_of_a_mixture_is_the_mixture_of_the_palettes(encoder: Tiny) -> None:
    vectors = encoder.embed_texts(TEXTS)
    palette = encoder.palette(vectors)
    assert palette.shape == (4, KNOTS, 3)
    mixed = encoder.palette(vectors.lerp(vectors.roll(1, 0), 0.3))
    torch.testing.assert_close(mixed, palette.lerp(palette.roll(1, 0), 0.3))


def test_colours_are_read_off_more_pixels_than_textures(encoder: Tiny) -> None:
    """Lines of one pixel survive at 96 pixels and are grey at 64: the ramp is that of the image."""
    lines = torch.zeros(1, 3, 96, 96)
    lines[..., ::2] = 1
    read = colors(lines)[0, :, 0]
    torch.testing.assert_close(read, (torch.arange(len(read)) >= len(read) // 2).float())
    small = torch.rand(1, 3, 20, 30, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(colors(small), ramp(small, COLORS))


def test_a_ramp_is_the_principal_order_of_the_colours_in_parts_of_equal_size() -> None:
    image, knots = smooth_image(22, [2, 3, 16, 24]), 8
    for row, each in enumerate(ramp(image, knots)):
        colors = image[row].double().flatten(1).T.numpy()
        centred = colors - colors.mean(0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        axis = axis if axis @ [0.299, 0.587, 0.114] > 0 else -axis
        expected = colors[np.argsort(centred @ axis)].reshape(knots, -1, 3).mean(1)
        np.testing.assert_allclose(each, expected, atol=1e-5)
