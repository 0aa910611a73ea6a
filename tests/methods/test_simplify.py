"""Fewer Gaussians: moments are kept where pairs merge, and pictures are nearer than those of a part of them."""

from dataclasses import replace

import pytest
import torch

from anystyle.contracts import Renderer
from anystyle.geometry.projection import covariances
from anystyle.methods import simplify
from anystyle.methods.simplify import simplified
from anystyle.registry.build import build
from anystyle.types import AntialiasedGaussians
from tests.support.known_scene import rig, wall


@pytest.fixture(scope="module")
def seen():
    """A wall, cameras before it, other cameras between these, and the renderer."""
    return wall(), rig().select([0, 2, 4, 6]), rig().select([1, 3, 5]), build(Renderer, "auto")


def decibels(first, second, cameras, renderer):
    with torch.no_grad():
        error = (renderer(first, cameras).color - renderer(second, cameras).color).square().mean()
    return float(-10 * error.log10())


def test_merged_gaussians_show_more_than_a_part_of_them(seen, monkeypatch):
    whole, cameras, others, renderer = seen
    number = whole.means.shape[1] // 8
    fewer = simplified(whole, cameras, renderer, number)
    assert fewer.means.shape[1] == number and bool((fewer.opacities <= 1).all())
    part = torch.randperm(whole.means.shape[1], generator=torch.Generator().manual_seed(0))[:number]
    size = whole.opacities[0] * whole.scales[0].prod(1)
    rivals = [whole.map(lambda tensor, rows=rows: tensor[:, rows]) for rows in (part, size.topk(number).indices)]
    monkeypatch.setattr(simplify, "STEPS", 0)
    merged = simplified(whole, cameras, renderer, number)
    found = [decibels(whole, each, others, renderer) for each in (fewer, merged, *rivals)]
    assert found[0] > found[1] + 0.5 and found[1] > max(found[2:]) + 0.5, found
    again = simplified(whole, cameras, renderer, number)
    assert merged.shares(again, ("means", "rotations", "scales", "opacities", "harmonics"))


def test_two_become_their_mixture(seen, monkeypatch):
    whole, cameras, _, renderer = seen
    monkeypatch.setattr(simplify, "STEPS", 0)
    pair = whole.map(lambda tensor: tensor[:, :1].repeat_interleave(2, 1))
    means = pair.means + torch.tensor([[[0.02, 0, 0], [-0.02, 0, 0]]])
    pair = replace(pair, means=means, harmonics=pair.harmonics * torch.tensor([1.0, 1.1]).view(1, 2, 1, 1))
    one = simplified(pair.marked(True), cameras, renderer, 1)
    assert isinstance(one, AntialiasedGaussians)
    spread = covariances(pair.rotations[0], pair.scales[0])[0]
    spread[0, 0] += 0.02**2
    torch.testing.assert_close(covariances(one.rotations[0], one.scales[0])[0], spread, rtol=0.05, atol=1e-5)
    assert float(one.opacities[0, 0]) == pytest.approx(0.999)  # twice 0.97 over hardly more area


def test_what_is_few_enough_or_alike_or_unseen_is_no_trouble(seen):
    whole, cameras, _, renderer = seen
    assert simplified(whole, cameras, renderer, whole.means.shape[1]) is whole
    same = whole.map(lambda tensor: tensor[:, :1].expand(-1, 50, *tensor.shape[2:]).contiguous())
    for scene in (same, replace(whole, means=whole.means - 100.0)):
        fewer = simplified(scene, cameras, renderer, 3)
        assert fewer.means.shape[1] == 3 and all(bool(tensor.isfinite().all()) for tensor in vars(fewer).values())
