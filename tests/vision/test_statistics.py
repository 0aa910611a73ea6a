"""Summaries of features against the goldens."""

import pytest
import torch
from torch import Tensor

from anystyle.vision.statistics import hellinger, mean_std, rgb_uv_histogram
from tests.support.oracle import assert_matches, golden, hashed


def test_mean_std_match_the_reference() -> None:
    record = golden("anystyle_golden")["calc_mean_std"]
    mean, std = mean_std(hashed(1070, [2, 3, 4, 5], -1, 1))
    torch.testing.assert_close(mean, torch.tensor(record["mean"]).flatten(1))
    torch.testing.assert_close(std, torch.tensor(record["std"]).flatten(1))


@pytest.fixture
def pair() -> tuple[Tensor, Tensor]:
    return hashed(1080, [1, 3, 16, 16]), hashed(1081, [1, 3, 16, 16]) ** 2


def test_histogram_and_hellinger_match_the_reference(pair: tuple[Tensor, Tensor]) -> None:
    record = golden("anystyle_golden")["rgb_uv_hist"]
    first, second = (rgb_uv_histogram(image) for image in pair)
    assert_matches(first, record["hist1"])
    assert hellinger(first, second).item() == pytest.approx(record["hellinger"], rel=1e-4)
    assert_matches(rgb_uv_histogram(hashed(1082, [1, 3, 300, 200])), record["hist_resized"])


def test_histogram_has_a_finite_gradient_even_where_images_agree(pair: tuple[Tensor, Tensor]) -> None:
    image = pair[0].clone().requires_grad_()
    other = rgb_uv_histogram(pair[0])
    hellinger(rgb_uv_histogram(image), other).sum().backward()
    assert torch.isfinite(image.grad).all()
    same = hellinger(other, other)
    torch.testing.assert_close(same, torch.zeros_like(same))
