"""Convolutions in tiles against PyTorch's own, in double precision."""

import pytest
import torch
from torch import nn

from anystyle.perception.winograd import NARROWEST, Conv3x3, quicken
from oracle import hashed


def convolution(channels=NARROWEST, width=NARROWEST + 3):
    conv = nn.Conv2d(channels, width, 3, padding=1).requires_grad_(False)
    conv.weight.copy_(hashed(1, conv.weight.shape, -1, 1) / (9 * channels) ** 0.5)
    assert conv.bias is not None
    conv.bias.copy_(hashed(2, conv.bias.shape, -1, 1))
    return conv


@pytest.mark.parametrize("size", [(1, 1), (4, 8), (5, 3), (14, 41)])
@torch.no_grad()
def test_any_size_is_convolved_as_exactly_as_single_precision_allows(size):
    conv = convolution()
    images = hashed(3, (2, NARROWEST, *size), -1, 1)
    wanted = conv.double()(images.double())
    conv.float()
    found = Conv3x3(conv)(images)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found.double(), wanted, rtol=0, atol=2e-5)
    # An image's result is its own: neither what lies beside it nor how it lies in memory matters.
    other = Conv3x3(conv)(images[1:].contiguous(memory_format=torch.channels_last))
    assert torch.equal(found[1:], other)


@torch.no_grad()
def test_strips_and_threads_change_nothing(monkeypatch):
    conv, images = Conv3x3(convolution()), hashed(4, (1, NARROWEST, 37, 18), -1, 1)
    whole = conv(images)
    monkeypatch.setattr("anystyle.perception.winograd.STRIP", 1)
    monkeypatch.setattr("anystyle.perception.winograd.FEWEST", 7)
    torch.testing.assert_close(conv(images), whole, rtol=0, atol=2e-6)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        torch.testing.assert_close(conv(images), whole, rtol=0, atol=2e-6)
    finally:
        torch.set_num_threads(threads)


def test_gradients_and_other_precisions_are_the_usual_convolutions():
    conv = convolution()
    tiled, images = Conv3x3(conv), hashed(5, (1, NARROWEST, 6, 6), -1, 1).requires_grad_()
    assert torch.equal(tiled(images), conv(images))
    tiled(images).sum().backward()
    assert images.grad is not None and bool(images.grad.abs().sum() > 0)
    with torch.no_grad():
        assert torch.equal(tiled.double()(images.double()), conv.double()(images.double()))


@torch.no_grad()
def test_only_what_gains_is_exchanged_and_keys_stay():
    network = nn.Sequential(
        convolution(),
        nn.Conv2d(51, 51, 3, padding=1, stride=2),
        nn.Sequential(nn.Conv2d(51, 51, 1), nn.Conv2d(51, 51, 3, padding=1), nn.Conv2d(51, 2, 3, padding=1)),
    )
    keys, images = list(network.state_dict()), hashed(6, (1, NARROWEST, 9, 9), -1, 1)
    before = network(images)
    quicken(network)
    kinds = [type(module) for module in network.modules() if isinstance(module, nn.Conv2d)]
    assert kinds == [Conv3x3, nn.Conv2d, nn.Conv2d, Conv3x3, nn.Conv2d]
    assert list(network.state_dict()) == keys
    torch.testing.assert_close(network(images), before, rtol=0, atol=2e-5)
    # Weights that are changed are not remembered as they were.
    network[0].weight.mul_(2)
    assert not torch.allclose(network(images), before, atol=1e-3)
