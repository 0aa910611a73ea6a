"""The 3D style loss: what fusing in voxels means, and a literal transcription."""

import math

import pytest
import torch
import torch.nn.functional as F

from anystyle.losses.style_3d import Style3D, fuse_in_voxels
from anystyle.types import Geometry
from anystyle.vision import networks
from oracle import hashed, smooth_image
from style_cases import cameras, filled_vgg_file, stylization


def test_fusion_is_the_softmax_weighted_mean_of_each_voxel() -> None:
    points, trust = hashed(1, [200, 3], -1, 1), hashed(2, [200], -3, 3)
    features = hashed(3, [5, 200], -1, 1)
    found = fuse_in_voxels(features, points, trust, 0.5)
    groups: dict[tuple[int, ...], list[int]] = {}
    for place, voxel in enumerate((points / 0.5).round().int().tolist()):
        groups.setdefault(tuple(voxel), []).append(place)
    expected = torch.stack(
        [(features[:, places] * trust[places].softmax(0)).sum(1) for _, places in sorted(groups.items())], dim=1
    )
    torch.testing.assert_close(found, expected)


def test_matches_a_literal_transcription() -> None:
    """Two scenes of two views at 35 x 42; layers at full and at half resolution."""
    vgg = networks.load("vgg19", filled_vgg_file())
    rendered, styles = smooth_image(5, [2, 2, 3, 35, 42]), smooth_image(7, [2, 3, 49, 28])
    depth, trust = 2 + hashed(9, [2, 2, 35, 42], 0, 0.1), hashed(10, [2, 2, 35, 42], 0, 4)
    geometry = Geometry(cameras(2, 2, (35, 42)), depth, trust)
    total = 0.0
    for share, layer in ((0.8, "relu1_1"), (0.2, "relu2_1")):
        (maps,) = vgg(rendered.flatten(0, 1), [layer])
        height, width = maps.shape[-2:]
        scale = math.sqrt(35 * 42 / (height * width))
        points = F.interpolate(
            geometry.points().flatten(0, 1).permute(0, 3, 1, 2), (height, width), mode="nearest-exact"
        )
        confidence = F.interpolate(trust.flatten(0, 1)[:, None], (height, width), mode="bilinear")
        for scene in range(2):
            views = slice(2 * scene, 2 * scene + 2)
            fused = fuse_in_voxels(
                maps[views].permute(1, 0, 2, 3).flatten(1),
                points[views].permute(0, 2, 3, 1).flatten(0, 2),
                confidence[views].flatten(),
                0.3 * scale,
            )
            (wanted,) = vgg(styles[scene][None], [layer])
            mean, spread = fused.mean(1), (fused.var(1) + 1e-5).sqrt()
            mean_style = wanted[0].flatten(1).mean(1)
            spread_style = (wanted[0].flatten(1).var(1) + 1e-5).sqrt()
            value = ((mean - mean_style) ** 2).mean() + ((spread - spread_style) ** 2).mean()
            total += share * value.item() / 2
    loss = Style3D(layers=("relu1_1", "relu2_1"), layer_weights=(4.0, 1.0), voxel_size=0.3)
    assert loss(stylization(rendered, rendered, styles, geometry=geometry)).item() == pytest.approx(total, rel=1e-4)


def test_views_that_agree_count_once() -> None:
    """A view seen twice changes nothing, for its features fall in the same voxels."""
    image, styles = smooth_image(5, [1, 1, 3, 35, 42]), smooth_image(7, [1, 3, 49, 28])
    loss = Style3D(layers=("relu1_1", "relu2_1"), layer_weights=(4.0, 1.0))
    once = loss(stylization(image, image, styles))
    twice = loss(stylization(image.expand(1, 2, -1, -1, -1), image.expand(1, 2, -1, -1, -1), styles))
    torch.testing.assert_close(once, twice, rtol=1e-4, atol=1e-6)
    assert loss(stylization(image, image)) == 0


def test_layer_weights_match_layers() -> None:
    with pytest.raises(ValueError, match="2 layers and 5 layer_weights"):
        Style3D(layers=("relu1_1", "relu2_1"))
