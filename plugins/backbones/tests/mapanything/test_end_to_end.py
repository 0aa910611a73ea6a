"""The whole network, from pixels to points and cameras, against the published implementation."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from anystyle.testing.oracle import fill_named, hashed, smooth_image
from anystyle_backbones import dino
from anystyle_backbones.dpt import ResidualConv
from anystyle_backbones.heads import decoded_maps
from anystyle_backbones.mapanything import MapAnything
from anystyle_backbones.mapanything.heads import GeometryHead
from anystyle_backbones.pointmaps import lens_of
from tests.support import mapanything_reference as reference
from tests.support.oracle import check

GOLDEN = reference.record()
CASES = [name for name, one in GOLDEN["tiny"].items() if isinstance(one, dict) and "records" in one]


def tiny() -> MapAnything:
    backbone = MapAnything(**reference.TINY)
    backbone.load_reference(reference.tiny_weights())
    backbone.freeze()
    return backbone


def predictions(backbone: MapAnything, images: Tensor) -> dict[str, Tensor]:
    """What the records hold, by their names, in the order of the computation."""
    head, taps = backbone.geometry_head, backbone.aggregator.taps
    assert isinstance(head, GeometryHead)
    stem = backbone.embedder(images)
    features = backbone.aggregator(stem)
    last = features[taps[-1]]
    geometry = head(features, images)
    size = images.shape[-2], images.shape[-1]
    dense = decoded_maps(head.dense, [features[layer] for layer in taps], size, chunk=head.chunk)
    scale = head.metric(last.data[:, 0, 0])
    rays = F.normalize(dense[..., :3], dim=-1)
    shown = {"patches": stem.patches, "cls": stem.data[:, :, 0], "scale_token": last.data[:, 0, 0]}
    shown |= {f"features_{place}": features[layer].patches for place, layer in enumerate(taps[1:])}
    shown |= {"dense": dense, "pose": head.pose(last.patches), "scale": scale[:, 0], "rays": rays}
    assert geometry.pointmap is not None
    local = geometry.pointmap - geometry.cameras.world_from_camera[:, :, None, None, :3, 3]
    shown |= {"depth_along_ray": local.norm(dim=-1), "depth_z": geometry.depth, "confidence": geometry.confidence}
    shown |= {"mask_logits": dense[..., 5], "points": geometry.pointmap, "poses": geometry.cameras.world_from_camera}
    return shown | {"intrinsics": matrices(lens_of(rays))}


def matrices(lens: Tensor) -> Tensor:
    fx, fy, cx, cy = lens.unbind(-1)
    zero = torch.zeros_like(fx)
    return torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, zero + 1], dim=-1).unflatten(-1, (3, 3))


def check_predictions(backbone: MapAnything, case: Mapping[str, Any]) -> None:
    shown = predictions(backbone, smooth_image(*case["images"]))
    assert shown.keys() == case["records"].keys()
    for name, value in shown.items():
        check(value, case["records"][name])


@pytest.mark.parametrize("name", CASES)
@torch.no_grad()
def test_tiny(name: str) -> None:
    check_predictions(tiny(), GOLDEN["tiny"][name])


def gate_second(backbone: MapAnything) -> None:
    for block in backbone.embedder.blocks:
        weight = block.mlp.w12.weight
        weight.copy_(weight.roll(len(weight) // 2, 0))


def within_views_first(backbone: MapAnything) -> None:
    first, second, *others = backbone.aggregator.blocks
    backbone.aggregator.blocks = nn.ModuleList([second, first, *others])


def no_reference(backbone: MapAnything) -> None:
    backbone.aggregator.reference.zero_()


def rectified(backbone: MapAnything) -> None:
    for layer in backbone.geometry_head.modules():
        if isinstance(layer, ResidualConv):
            layer.rectified = True


def waves(backbone: MapAnything) -> None:
    backbone.geometry_head.dense.waves = True


def resized_not_cropped(backbone: MapAnything) -> None:
    backbone.geometry_head.dense.fusions.cropped = False


def real_part_first(backbone: MapAnything) -> None:
    backbone.geometry_head.pose.quaternion.weight.copy_(backbone.geometry_head.pose.quaternion.weight.roll(1, 0))


def normed_class_token(backbone: MapAnything) -> None:
    embed, norm = backbone.embedder.forward, backbone.embedder.norm
    backbone.embedder.forward = lambda images: (
        lambda stem: stem.with_data(torch.cat([norm(stem.data[:, :, :1]), stem.patches], dim=2))
    )(embed(images))


def activated_scale(backbone: MapAnything) -> None:
    backbone.geometry_head.scale[0] = nn.Sequential(backbone.geometry_head.scale[0], nn.ReLU())


MISTAKES = [
    ("patches", gate_second),
    ("cls", normed_class_token),
    ("features_0", no_reference),
    ("features_0", within_views_first),
    ("dense", rectified),
    ("dense", waves),
    ("dense", resized_not_cropped),
    ("pose", real_part_first),
    ("scale", activated_scale),
]


@pytest.mark.parametrize(("name", "mistake"), MISTAKES, ids=lambda one: getattr(one, "__name__", one))
@torch.no_grad()
def test_a_mistake_is_seen(name: str, mistake: Callable[[MapAnything], None]) -> None:
    """In the record of the first value that it changes."""
    case, backbone = GOLDEN["tiny"]["v3_42x70"], tiny()
    mistake(backbone)
    shown = predictions(backbone, smooth_image(*case["images"]))
    with pytest.raises(AssertionError):
        check(shown[name], case["records"][name])


def test_positions_resampled_to_a_size_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dino, "OFFSET", 0.0)
    case = GOLDEN["tiny"]["v2_56x84"]
    with torch.no_grad(), pytest.raises(AssertionError):
        check(tiny().embedder(smooth_image(*case["images"])).patches, case["records"]["patches"])


def test_lenses() -> None:
    """Rays of two pinhole cameras with noise, of an image with more rows and columns than are read."""
    case = GOLDEN["tiny"]["lens"]
    noise = hashed(*case["noise"])
    rows, columns = torch.meshgrid(torch.arange(120.0), torch.arange(170.0), indexing="ij")
    lens = torch.tensor([[90.0, 100.0, 80.3, 65.1], [150.0, 140.0, 90.7, 50.2]])[:, :, None, None]
    slopes = [(columns - lens[:, 2]) / lens[:, 0], (rows - lens[:, 3]) / lens[:, 1], torch.ones(2, 120, 170)]
    rays = F.normalize(torch.stack(slopes, dim=-1) + 0.05 * noise, dim=-1)
    expected = torch.tensor(case["intrinsics"])
    torch.testing.assert_close(matrices(lens_of(rays[None]))[0], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
@torch.no_grad()
def test_full() -> None:
    with torch.device("meta"):
        backbone = MapAnything()
    backbone.load_reference(fill_named(reference.shapes("full"), GOLDEN["fill"]["rules"]))
    backbone.gaussian_head.to_empty(device="cpu")
    backbone.freeze()
    check_predictions(backbone, GOLDEN["full"]["v2_56x84"])
