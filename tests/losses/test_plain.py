"""Losses on images, depths and colours against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from anystyle.losses.depth_consistency import DepthConsistency
from anystyle.losses.edge_aware_smoothness import EdgeAwareSmoothness
from anystyle.losses.histogram import Histogram
from anystyle.losses.luminance import Luminance
from anystyle.losses.palette_ramp import PaletteRamp
from anystyle.losses.total_variation import TotalVariation
from anystyle.perception.ramps import luma, painted, ramp, shares
from anystyle.types import Geometry
from oracle import golden, hashed, smooth_image
from style_cases import cameras, stylization

PHOTOGRAPHS = smooth_image(11, [2, 2, 3, 28, 35])


def test_total_variation_of_a_ramp_and_of_a_constant() -> None:
    rising = (torch.arange(35.0) / 100 + torch.arange(28.0)[:, None] / 50).expand(2, 2, 3, 28, 35)
    assert TotalVariation()(stylization(rising, rising)).item() == pytest.approx(0.01**2 + 0.02**2, rel=1e-4)
    flat = torch.full_like(rising, 0.4)
    assert TotalVariation()(stylization(flat, flat)) == 0


def test_edge_aware_smoothness_of_a_ramp_is_damped_by_the_photographs_own_slope() -> None:
    rising = (torch.arange(35.0) / 100 + torch.arange(28.0)[:, None] / 50).expand(2, 2, 3, 28, 35)
    flat = torch.full_like(rising, 0.4)
    loss = EdgeAwareSmoothness(sharpness=20.0)
    assert loss(stylization(rising, flat)).item() == pytest.approx(0.01 + 0.02, rel=1e-4)
    damped = 0.01 * math.exp(-20 * 0.01) + 0.02 * math.exp(-20 * 0.02)
    assert loss(stylization(rising, rising)).item() == pytest.approx(damped, rel=1e-4)
    assert loss(stylization(flat, rising)) == 0
    with pytest.raises(ValueError, match="give 0 or more"):
        EdgeAwareSmoothness(sharpness=-1.0)


def test_depth_consistency_is_the_mean_square_against_the_predicted_depth() -> None:
    depth, rendered = hashed(1, [2, 2, 28, 35], 1, 3), hashed(2, [2, 2, 28, 35], 1, 3)
    geometry = Geometry(cameras(2, 2, (28, 35)), depth, torch.ones_like(depth))
    result = stylization(PHOTOGRAPHS, PHOTOGRAPHS, rendered_depth=rendered, geometry=geometry)
    expected = ((rendered - depth) ** 2).sum() / depth.numel()
    torch.testing.assert_close(DepthConsistency()(result), expected)


def test_histogram_is_the_published_distance() -> None:
    first, second = hashed(1080, [1, 3, 16, 16]), hashed(1081, [1, 3, 16, 16]) ** 2
    rendered = torch.stack([first[0], second[0]])[None]  # the second view is the style itself
    result = stylization(rendered, rendered, second)
    expected = golden("anystyle_golden")["rgb_uv_hist"]["hellinger"] / 2
    assert Histogram()(result).item() == pytest.approx(expected, rel=1e-4)
    assert Histogram()(stylization(rendered, rendered)) == 0


def test_luminance_ignores_mean_contrast_and_what_is_finer_than_its_scale() -> None:
    loss = Luminance(scales=(8,), shares=(1.0,))
    photographs = smooth_image(13, [1, 1, 3, 56, 56])
    fine = 0.1 * ((torch.arange(56) % 4 < 2).float() - 0.5)  # stripes that average to nothing over 8 pixels
    recoloured = 0.6 * photographs + 0.2 + fine
    assert loss(stylization(recoloured, photographs)).item() == pytest.approx(0, abs=2e-3)
    turned = 1 - photographs
    assert loss(stylization(turned, photographs)).item() == pytest.approx(4, rel=0.05)


def test_luminance_weighs_its_scales() -> None:
    rendered, photographs = smooth_image(15, [1, 2, 3, 56, 56]), smooth_image(13, [1, 2, 3, 56, 56])
    result = stylization(rendered, photographs)
    coarse, fine = (Luminance(scales=(scale,), shares=(1.0,))(result) for scale in (8, 4))
    both = Luminance(scales=(8, 4), shares=(1.0, 0.15))(result)
    torch.testing.assert_close(both, coarse + 0.15 * fine)
    with pytest.raises(ValueError, match="2 scales and 1 shares"):
        Luminance(shares=(1.0,))


def test_luminance_of_a_flat_view_is_finite() -> None:
    flat = torch.full((1, 1, 3, 56, 56), 0.5, requires_grad=True)
    Luminance()(stylization(flat, smooth_image(13, [1, 1, 3, 56, 56]))).backward()
    assert torch.isfinite(flat.grad).all()


def test_palette_ramp_is_the_transcription_with_scipy_and_numpy() -> None:
    photographs, style = smooth_image(21, [2, 2, 3, 12, 15]), smooth_image(22, [2, 3, 16, 24])
    rendered = smooth_image(23, [2, 2, 3, 12, 15])
    knots, errors = 8, []
    for scene in range(2):
        luma = np.tensordot([0.299, 0.587, 0.114], photographs[scene].double().numpy(), (0, 1))  # V H W
        share = (stats.rankdata(luma, method="ordinal") - 1).reshape(luma.shape) / luma.size
        colors = style[scene].double().flatten(1).T.numpy()
        centred = colors - colors.mean(0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        axis = axis if axis @ [0.299, 0.587, 0.114] > 0 else -axis
        steps = colors[np.argsort(centred @ axis)].reshape(knots, -1, 3).mean(1)
        wanted = np.stack([np.interp(share * (knots - 1), np.arange(knots), steps[:, c]) for c in range(3)], 1)
        errors.append(((rendered[scene].double().numpy() - wanted) ** 2).mean())
    result = stylization(rendered, photographs, style)
    assert PaletteRamp(knots=knots)(result).item() == pytest.approx(np.mean(errors), rel=1e-4)
    only_second = stylization(rendered, photographs, style, has_image=torch.tensor([False, True]))
    assert PaletteRamp(knots=knots)(only_second).item() == pytest.approx(errors[1], rel=1e-4)
    assert PaletteRamp()(stylization(rendered, photographs)) == 0


def test_palette_ramp_lays_the_pattern_over_the_scene_from_the_first_camera() -> None:
    photographs, style = smooth_image(21, [1, 2, 3, 12, 16]), smooth_image(22, [1, 3, 16, 24])
    columns = (torch.arange(16) % 4 < 2).float().expand(12, 16)
    given = cameras(1, 2, (12, 16))  # both views look the same way from the same place
    flat = torch.ones(1, 2, 12, 16)
    result = stylization(photographs, photographs, style, geometry=Geometry(given, flat, flat))
    result = replace(result, style=replace(result.style, pattern=columns[None]))
    colors = ramp(style, 8)
    light = shares(luma(photographs))
    # Where the pattern is dark, the darker half of the ramp, whatever the photograph.
    whole = PaletteRamp(knots=8, pattern=1.0).target(result, colors)
    place = (stats.rankdata(columns.expand(1, 2, 12, 16).flatten().numpy(), method="ordinal") - 1) / 384
    expected = np.stack([np.interp(place * 7, np.arange(8), colors[0, :, c].numpy()) for c in range(3)])
    np.testing.assert_allclose(whole[0].movedim(1, 0).flatten(1), expected, atol=1e-5)
    # Half and half, every share of the ramp is still met once, and the lightest and darkest pixels are given back.
    half = PaletteRamp(knots=8, pattern=0.5, shade=0.4).target(result, colors)
    plain = painted(shares(0.5 * light + 0.5 * columns), colors) * (1 + 0.4 * (2 * light - 1))[:, :, None]
    torch.testing.assert_close(half, plain.clamp(0, 1))
    torch.testing.assert_close(PaletteRamp(knots=8).target(result, colors), painted(light, colors).clamp(0, 1))
    with pytest.raises(ValueError, match=r"palette_ramp\.shade is 2.0; give a share"):
        PaletteRamp(shade=2.0)


def test_palette_ramp_of_two_colours_parts_light_from_dark_whatever_the_exposure() -> None:
    navy, orange = torch.tensor([0.08, 0.12, 0.35]), torch.tensor([0.95, 0.5, 0.1])
    style = torch.stack([navy, orange], -1)[None, :, :, None].repeat(1, 1, 1, 4).permute(0, 1, 3, 2)  # 1 3 4 2
    photographs = hashed(24, [1, 1, 3, 6, 6], 0, 1)
    target = painted(shares(luma(photographs)), ramp(style, 2))
    darkest = (photographs * torch.tensor([0.299, 0.587, 0.114])[:, None, None]).sum(2).flatten().argmin()
    assert target.flatten(3)[0, 0, :, darkest].tolist() == pytest.approx(navy.tolist())
    assert target.mean((1, 3, 4))[0].tolist() == pytest.approx(((navy + orange) / 2).tolist(), abs=0.02)
    torch.testing.assert_close(painted(shares(luma(photographs**2 * 0.5)), ramp(style, 2)).mean(), target.mean())
    assert PaletteRamp(knots=2)(stylization(target, photographs, style)).item() == pytest.approx(0, abs=1e-12)
    with pytest.raises(ValueError, match="give at least 2"):
        PaletteRamp(knots=1)
