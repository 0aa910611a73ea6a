"""Layers that backbones share: closed forms, and another implementation where there is one."""

import math

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from anystyle.nn.attention import Attention
from anystyle.nn.tokens import IMAGENET_MEAN, IMAGENET_STD, grid_of, normalised
from anystyle.testing.oracle import hashed
from anystyle.types import Cameras
from anystyle_backbones import dpt, heads


def test_attention_is_torch_s_own() -> None:
    torch.manual_seed(0)
    ours, theirs = Attention(16, 4, qk_norm=False), nn.MultiheadAttention(16, 4, batch_first=True)
    into = {"in_proj_weight": ours.qkv.weight, "in_proj_bias": ours.qkv.bias}
    theirs.load_state_dict(into | {"out_proj.weight": ours.proj.weight, "out_proj.bias": ours.proj.bias})
    x = hashed(1, (2, 5, 16), -1, 1)
    torch.testing.assert_close(ours(x), theirs(x, x, x, need_weights=False)[0], rtol=1e-5, atol=1e-6)


def test_what_passes_around_convolutions_is_rectified_or_not() -> None:
    x = hashed(4, (1, 4, 3, 3), -1, 1)
    for rectified, expected in ((True, F.relu(x)), (False, x)):
        block = dpt.ResidualConv(4, rectified=rectified)
        for parameter in block.parameters():
            nn.init.zeros_(parameter)
        assert torch.equal(block(x), expected)


@pytest.mark.parametrize("chunk", [1, 2, 5, 9])
def test_views_in_parts_are_the_views_at_once(chunk: int) -> None:
    values = hashed(5, (2, 5, 3), -1, 1)
    assert torch.equal(dpt.by_views(lambda some: values[:, some] * 2, 5, chunk), values * 2)


def test_cameras_are_where_their_encoding_says() -> None:
    angle = math.radians(30)
    encoding = torch.tensor([[[1.0, 2, 3, 0, math.sin(angle / 2), 0, math.cos(angle / 2), 1.0, 0.8]]])
    turned = torch.tensor([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    torch.testing.assert_close(heads.rotation_of(encoding)[0, 0], turned)
    cameras = heads.centred_cameras(
        heads.rotation_of(encoding), encoding[..., :3], (encoding[..., 7:] / 2).tan(), (6, 8)
    )
    assert isinstance(cameras, Cameras)
    torch.testing.assert_close(cameras.intrinsics[0, 0, :2, 2], torch.tensor([4.0, 3.0]))
    expected = torch.tensor([8 / 2 / math.tan(0.4), 6 / 2 / math.tan(0.5)])
    torch.testing.assert_close(cameras.intrinsics[0, 0].diagonal()[:2], expected)
    torch.testing.assert_close(cameras.world_from_camera[0, 0, :3], torch.cat([turned, encoding[0, 0, :3, None]], 1))


def test_pixels_are_normalised_and_counted_in_patches() -> None:
    mean, std = (torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))
    images = mean.expand(2, 3, 28, 42) + std
    torch.testing.assert_close(normalised(images), torch.ones(2, 3, 28, 42))
    assert grid_of(images, 14) == (2, 3)
    with pytest.raises(ValueError, match="28x42 pixels; sides must be multiples of 16: resize them"):
        grid_of(images, 16)
