"""What RAFT computes with less work against the same as published, in double precision."""

import pytest
import torch
import torch.nn.functional as F

from anystyle.perception import lines, raft
from anystyle.perception.correlations import correlations, look_up, sample
from evaluation_cost import published_upsampling
from oracle import hashed


@pytest.mark.parametrize("axis", [2, 3])
@pytest.mark.parametrize("size", [(1, 1), (4, 8), (5, 3), (14, 41)])
@torch.no_grad()
def test_lines_are_convolved_as_exactly_as_single_precision_allows(axis, size):
    weight = hashed(1, (51, 48, 5), -1, 1) / (5 * 48) ** 0.5
    images = hashed(2, (2, 48, *size), -1, 1)
    kernel, padding = (weight[:, :, :, None], (2, 0)) if axis == 2 else (weight[:, :, None], (0, 2))
    found = lines.convolve(images, lines.values_of(weight), axis)
    assert found.dtype == torch.float32
    torch.testing.assert_close(
        found.double(), F.conv2d(images.double(), kernel.double(), padding=padding), rtol=0, atol=1e-5
    )


@torch.no_grad()
def test_strips_of_lines_and_threads_change_nothing(monkeypatch):
    images, values = hashed(3, (1, 48, 37, 18), -1, 1), lines.values_of(hashed(4, (51, 48, 5), -1, 1) / 15)
    whole = lines.convolve(images, values, 3)
    monkeypatch.setattr(lines, "STRIP", 1)
    monkeypatch.setattr(lines, "FEWEST", 7)
    torch.testing.assert_close(lines.convolve(images, values, 3), whole, rtol=0, atol=2e-6)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        torch.testing.assert_close(lines.convolve(images, values, 3), whole, rtol=0, atol=2e-6)
    finally:
        torch.set_num_threads(threads)


@torch.no_grad()
def test_windows_of_correlations_are_those_that_are_sampled_place_by_place():
    source, target = hashed(5, (2, 2, 8, 16, 20), -1, 1)
    pyramid = correlations(source, target)
    place = hashed(6, (2, 2, 16, 20), -14, 34)
    # On whole pixels, on the border, and as far away as nothing is.
    place[0, :, 0, :4] = torch.tensor([[3, 0, 19, 1e30], [5, 15, -5, -1e30]])
    found = look_up(pyramid, place)
    torch.testing.assert_close(found, sample(pyramid, place), rtol=0, atol=2e-5)
    assert bool((found != 0).any()) and bool((found[0, :, 0, 3] == 0).all())
    wide = sample([level.double() for level in pyramid], place.double())
    torch.testing.assert_close(found.double(), wide, rtol=0, atol=2e-5)


@torch.no_grad()
def test_a_settled_recurrent_unit_is_the_one_that_was_loaded():
    unit = raft.Recurrent()
    for index, parameter in enumerate(unit.parameters()):
        parameter.copy_(hashed(10 + index, parameter.shape, -1, 1) / 30)
    keys = list(unit.state_dict())
    state, context, motion = hashed(7, (3, 1, 128, 9, 14), -1, 1)
    reading = unit.read(context).split(384, dim=1)
    before = unit(state, reading, motion)
    unit.settle()
    torch.testing.assert_close(unit(state, reading, motion), before, rtol=0, atol=1e-5)
    assert list(unit.state_dict()) == keys
    # Without lines it is the usual one, in any precision.
    known = [part.double() for part in reading]
    torch.testing.assert_close(unit.double()(state.double(), known, motion.double()).float(), before, rtol=0, atol=1e-5)


@torch.no_grad()
def test_upsampling_is_the_published_one():
    flow, logits = hashed(8, (2, 2, 5, 7), -9, 9), hashed(9, (2, 576, 5, 7), -3, 3)
    torch.testing.assert_close(raft.upsample(flow, logits), published_upsampling(flow, logits), rtol=0, atol=2e-5)
