import torch

from anystyle.geometry.warp import backward_warp, sample_at, softmax_splat
from anystyle.testing.oracle import assert_matches, hashed
from tests.support.oracle import golden

GOLDEN = golden("anystyle_golden")


def test_backward_warp_matches_the_published_sampling():
    image, flow = hashed(1100, (1, 3, 6, 8), 0, 255), hashed(1101, (1, 2, 6, 8), -2, 2)
    assert_matches(backward_warp(image, flow), GOLDEN["backwarp"]["out"], rtol=1e-4, atol=1e-3)


def test_splatting_matches_the_published_pair():
    first = hashed(1130, (1, 3, 6, 8), 0, 255)
    second = (0.97 * first + hashed(1131, (1, 3, 6, 8), -6, 6)).clamp(0, 255)
    flow = hashed(1132, (1, 2, 6, 8), -1.5, 1.5)
    for key, scale, atol in (("softsplat_pair", 1.0, 1e-3), ("softsplat_pair_unit_range", 255.0, 1e-5)):
        change = first / scale - backward_warp(second / scale, flow)
        importance = (-10 * change.abs().mean(1, keepdim=True)).clip(-10, 10)
        assert_matches(importance, GOLDEN[key]["metric"], rtol=1e-4, atol=1e-4)
        assert_matches(softmax_splat(first / scale, flow, importance).image, GOLDEN[key]["warped"], atol=atol)


def test_whole_pixel_flow_moves_pixels_and_keeps_their_sum():
    image = torch.rand(2, 3, 7, 9)
    flow = torch.zeros(2, 2, 7, 9)
    flow[:, 0] = 2
    moved = softmax_splat(image, flow, torch.zeros(2, 1, 7, 9))
    torch.testing.assert_close(moved.image[..., 2:], image[..., :-2], rtol=1e-5, atol=1e-6)
    assert (moved.weight[..., :2] == 0).all() and (moved.image[..., :2] == 0).all()
    torch.testing.assert_close(sample_at(moved.image, flow)[..., :-2], image[..., :-2], rtol=1e-5, atol=1e-6)


def test_a_pixel_without_finite_flow_is_dropped():
    image = torch.ones(1, 1, 3, 3)
    flow = torch.zeros(1, 2, 3, 3)
    flow[0, 0, 1, 1] = torch.nan
    weight = softmax_splat(image, flow, torch.zeros(1, 1, 3, 3)).weight
    assert weight[0, 0, 1, 1] == 0 and weight.sum() == 8
