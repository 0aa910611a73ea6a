"""Metrics against other libraries that compute the same thing."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from scipy.spatial.distance import euclidean
from scipy.special import rel_entr, softmax
from torchmetrics.functional.image import lpips as their_lpips

from anystyle.testing.oracle import hashed, smooth_image
from anystyle.vision import lpips, vgg, weights
from anystyle.vision.statistics import hellinger, rgb_uv_histogram
from anystyle_metrics.cfsd import MAX_EXPONENT, structural_distance
from tests.support.judging_cases import filled_folder


@pytest.mark.parametrize("backbone", ["alex", "vgg"])
def test_lpips_has_torchmetrics_heads_and_combines_them_alike(backbone, monkeypatch):
    """Their scaling, normalisation, linear layers and published heads, on the features of one network."""
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(filled_folder()))
    network = lpips.load(backbone, "published")
    first, second = smooth_image(61, [2, 3, 64, 64]), smooth_image(62, [2, 3, 64, 64])
    scaled = [their_lpips.ScalingLayer()(2 * images - 1) for images in (first, second)]
    mean, std = (torch.tensor(each).view(3, 1, 1) for each in (vgg.MEAN, vgg.STD))
    # The network normalises what it gets; what it is to see is theirs.
    maps = [network.network(images * std + mean, network.layers) for images in scaled]
    heads = weights.read(weights.find(f"lpips_{backbone}"))
    total = torch.zeros(2)
    for place, (one, other) in enumerate(zip(*maps, strict=True)):
        layer = their_lpips.NetLinLayer(one.shape[1], use_dropout=True).eval()
        layer.load_state_dict({"model.1.weight": heads[f"lin{place}.model.1.weight"]})
        gap = their_lpips._normalize_tensor(one) - their_lpips._normalize_tensor(other)
        total = total + their_lpips._spatial_average(layer(gap.square()), keep_dim=False)[:, 0].detach()
    # Theirs has its constant inside of the root, where features are large.
    torch.testing.assert_close(network(first, second), total, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("reach", "steep"), [(0.5, False), (2.0, False), (4.0, True)])
def test_structural_distance_is_scipys_relative_entropy(reach, steep):
    """In both ways that it is computed in: in blocks, and row by row where similarities are far apart."""
    first, second = hashed(71, (12, 9, 11), 0, 12 * reach), hashed(72, (12, 9, 11), 0, 12 * reach)
    second = 0.9 * first + 0.1 * second
    rows = [features.flatten(1).double().numpy() / 12 for features in (first, second)]
    assert (max(float((row**2).sum(0).max()) for row in rows) > MAX_EXPONENT) is steep
    shares = [softmax(row.T @ row, axis=1) for row in rows]
    expected = rel_entr(shares[1], shares[0]).sum()
    np.testing.assert_allclose(float(structural_distance(first, second)), expected, rtol=1e-4)


def test_flat_similarities_are_told_apart(monkeypatch):
    """Where single precision loses a row's entropy in rounding: real features divided by 256 channels are that flat."""
    monkeypatch.setattr("anystyle_metrics.cfsd.BLOCK", 16)
    first, second = hashed(73, (32, 12, 12)), hashed(74, (32, 12, 12))
    rows = [features.flatten(1).double() / 32 for features in (first, second)]
    found, wanted = ((row.T @ row).log_softmax(-1) for row in rows)
    expected = F.kl_div(found, wanted, reduction="sum", log_target=True)
    assert expected < 1e-3
    np.testing.assert_allclose(float(structural_distance(first, second)), float(expected), rtol=1e-5)


def test_histograms_are_as_far_apart_as_scipy_says():
    one, other = (rgb_uv_histogram(smooth_image(seed, [1, 3, 48, 48])) for seed in (81, 82))
    theirs = euclidean(one.double().sqrt().flatten().numpy(), other.double().sqrt().flatten().numpy()) / 2**0.5
    np.testing.assert_allclose(float(hellinger(one, other)), theirs, rtol=1e-5)
