"""Layers that backbones share: closed forms, and another implementation where there is one."""

import math

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from anystyle.nn import dpt, pose, rope
from anystyle.nn.attention import Attention, Block, start_as_dino
from anystyle.nn.pixels import IMAGENET_MEAN, IMAGENET_STD, grid_of, normalised
from anystyle.types import Cameras
from oracle import hashed


def test_attention_is_torch_s_own() -> None:
    torch.manual_seed(0)
    ours, theirs = Attention(16, 4, qk_norm=False), nn.MultiheadAttention(16, 4, batch_first=True)
    theirs.load_state_dict(
        {
            "in_proj_weight": ours.qkv.weight,
            "in_proj_bias": ours.qkv.bias,
            "out_proj.weight": ours.proj.weight,
            "out_proj.bias": ours.proj.bias,
        }
    )
    x = hashed(1, (2, 5, 16), -1, 1)
    torch.testing.assert_close(ours(x), theirs(x, x, x, need_weights=False)[0], rtol=1e-5, atol=1e-6)


def test_a_block_whose_gains_are_zero_passes_tokens_on() -> None:
    block = Block(8, 2, mlp_ratio=2.0, layer_scale=0.0)
    x = hashed(2, (1, 3, 8), -1, 1)
    assert torch.equal(block(x), x)


def test_initial_values_are_dino_s() -> None:
    torch.manual_seed(0)
    block = Block(64, 4, mlp_ratio=4.0, layer_scale=1.0)
    start_as_dino(block)
    assert float(block.mlp.fc1.weight.detach().std()) == pytest.approx(0.02, rel=0.05)  # type: ignore[union-attr]
    assert not bool(block.attn.qkv.bias.any())


def test_special_tokens_do_not_turn() -> None:
    angles = rope.rotary(rope.grid_positions((2, 2), special=3), 8, base=100.0, like=torch.zeros(1))
    x = hashed(3, (7, 8), -1, 1)
    turned = rope.rotate(x, angles)
    assert torch.equal(turned[:3], x[:3]) and not torch.allclose(turned[3:], x[3:])
    torch.testing.assert_close(turned.norm(dim=-1), x.norm(dim=-1))
    assert torch.equal(angles.repeat(2).cos, angles.cos.repeat(2, 1))


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


@pytest.mark.parametrize(("features", "channels"), [(12, (8, 8, 8, 8)), (16, (8, 8, 8)), (16, (8, 6, 8, 8))])
def test_widths_of_a_decoder_are_checked(features: int, channels: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="multiple of 8, and the four levels multiples of 4"):
        dpt.Dpt(dim=8, features=features, channels=channels, hidden=8, outputs=2)


def test_a_decoder_fills_an_image_that_is_not_square() -> None:
    torch.manual_seed(0)
    decoder = dpt.Dpt(dim=8, features=16, channels=(8, 8, 8, 8), hidden=8, outputs=3)
    levels = [decoder.norm(hashed(seed, (2, 6, 8), -1, 1)) for seed in range(4)]
    decoded = decoder.decode(levels, (2, 3), (28, 42))
    assert decoded.shape == (2, 8, 28, 42) and decoder.predict_(decoded).shape == (2, 28, 42, 3)
    assert decoder.dtype == torch.float32
    assert (
        "norm.weight"
        not in dpt.Dpt(dim=8, features=16, channels=(8,) * 4, hidden=8, outputs=3, normed=False).state_dict()
    )


def test_cameras_are_where_their_encoding_says() -> None:
    angle = math.radians(30)
    encoding = torch.tensor([[[1.0, 2, 3, 0, math.sin(angle / 2), 0, math.cos(angle / 2), 1.0, 0.8]]])
    turned = torch.tensor([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    torch.testing.assert_close(pose.rotation_of(encoding)[0, 0], turned)
    cameras = pose.centred_cameras(pose.rotation_of(encoding), encoding[..., :3], (encoding[..., 7:] / 2).tan(), (6, 8))
    assert isinstance(cameras, Cameras)
    torch.testing.assert_close(cameras.intrinsics[0, 0, :2, 2], torch.tensor([4.0, 3.0]))
    torch.testing.assert_close(pose.encode(cameras.world_from_camera, cameras), encoding)


def test_pixels_are_normalised_and_counted_in_patches() -> None:
    mean, std = (torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))
    images = mean.expand(2, 3, 28, 42) + std
    torch.testing.assert_close(normalised(images), torch.ones(2, 3, 28, 42))
    assert grid_of(images, 14) == (2, 3)
    with pytest.raises(ValueError, match="28x42 pixels; both sides must be multiples of 16: resize them"):
        grid_of(images, 16)
