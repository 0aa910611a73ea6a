"""Parts of AnySplat with the weights that the goldens were computed with."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from anystyle.contracts import Backbone
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.testing.oracle import hashed
from anystyle.types import Attributes, Gaussians, Scene, Site
from tests.support import oracle
from tests.support.oracle import fill_sorted


def fill(module: nn.Module, names: Callable[[Sequence[str]], Mapping[str, str]], *, published: str) -> int:
    """Give a module the hash-filled weights and return their number; ``published`` is cut off the published names."""
    state = module.state_dict()
    local = {key: name.removeprefix(published) for key, name in names(list(state)).items()}
    filled = fill_sorted({local[key]: tensor for key, tensor in state.items()})
    module.load_state_dict({key: filled[local[key]].view_as(tensor) for key, tensor in state.items()})
    module.eval()
    return len(local)


def style_vector(index: int = 6 + 1000, rows: int = 1) -> Tensor:
    """The style that goldens were computed with: unit rows of hashed numbers."""
    return torch.nn.functional.normalize(hashed(index, (rows, 512), -1, 1), dim=-1)


def published_injector(site: Site) -> ZeroConv:
    return ZeroConv(dim=site.dim, style_dim=512, hidden=256 if site.name == "head/direct" else 1024)


def raw_maps(attributes: Attributes) -> Tensor:
    """Attributes as the published head lays them out, B V 84 H W."""
    assert attributes.confidence is not None
    parts = [attributes.opacity[..., None], attributes.scale, attributes.rotation, attributes.color.flatten(4)]
    return torch.cat([*parts, attributes.confidence[..., None]], dim=-1).movedim(-1, 2)


def check(actual: Tensor, record: Mapping[str, Any]) -> None:
    oracle.check(actual.reshape(record["shape"]), record)


def close(actual: Tensor, expected: Any) -> None:
    torch.testing.assert_close(actual.flatten(), torch.tensor(expected).flatten(), rtol=0, atol=1e-4)


def check_scene(backbone: Backbone, scene: Scene, record: Mapping[str, Any]) -> None:
    check(scene.views.images, record["image"])
    check(scene.stem.data, record["package_tokens"])
    layers = [scene.features[layer] for layer in sorted(scene.features) if layer >= 0]
    for tokens, layer in zip(layers, record["layers"], strict=True):
        check(tokens.data, layer)
    with torch.no_grad():
        passes = backbone.geometry_head.camera(layers[-1].data[:, :, 0])
    close(passes, record["pose_enc_iters"])
    cameras = scene.cameras
    close(cameras.world_from_camera, record["c2w"])
    height, width = cameras.size
    close(cameras.intrinsics / torch.tensor([width, height, 1.0])[:, None], record["K_normalised"])
    check(scene.geometry.depth, record["depth"])
    check(scene.geometry.confidence, record["depth_conf"])
    points = scene.geometry.points(pixel_center=0.0)
    check(points, record["points"])
    assert points.double().norm(dim=-1).mean().item() == pytest.approx(record["scene_scale"], rel=1e-4)
    assert scene.attributes.confidence is not None and scene.clusters is not None
    check(scene.attributes.confidence, record["fusion_conf"])
    ratio = scene.clusters.means.shape[1] / math.prod(scene.geometry.depth.shape[1:])
    assert ratio == pytest.approx(record["voxelize_ratio"], rel=1e-3)


def rows_of(scene: Scene, batch: int, cells: Sequence[Sequence[int]], voxel_size: float) -> list[int]:
    """The Gaussians that stand for voxels."""
    assert scene.clusters is not None
    places = (scene.geometry.points(0.0)[batch].flatten(0, 2) / voxel_size).round().long()
    return [int(scene.clusters.index[batch][(places == torch.tensor(cell)).all(-1)][0]) for cell in cells]


def check_gaussians(
    scene: Scene, gaussians: Gaussians, records: Sequence[Mapping[str, Any]], voxel_size: float
) -> None:
    assert scene.clusters is not None
    for batch, record in enumerate(records):
        valid = scene.clusters.valid[batch]
        assert int(valid.sum()) == pytest.approx(record["n_voxels"], rel=1e-3)
        assert list(gaussians.harmonics[batch, valid].mT.shape[1:]) == record["harmonics_shape"][1:]
        found = {
            "means": gaussians.means[batch, valid],
            "scales": gaussians.scales[batch, valid],
            "rotations_xyzw": gaussians.rotations[batch, valid].roll(-1, -1),
            "opacities": gaussians.opacities[batch, valid, None],
            "harmonics_dc": gaussians.harmonics[batch, valid, 0],
        }
        for name, values in found.items():
            check_moments(values, record["stats"][name])
        if "harmonics_l2" in record["stats"]:
            norm = gaussians.harmonics[batch, valid].double().norm().item()
            assert norm == pytest.approx(record["stats"]["harmonics_l2"], rel=1e-4)
        samples = record["samples"]
        check_samples(found, rows_of(scene, batch, [sample["voxel"] for sample in samples], voxel_size), samples)


def check_moments(values: Tensor, record: Mapping[str, Sequence[float]]) -> None:
    """Mean and root mean square over Gaussians."""
    for statistic, expected in record.items():
        power = values.double().mean(0) if statistic == "mean" else values.double().square().mean(0).sqrt()
        np.testing.assert_allclose(power.numpy(), expected, rtol=1e-4, atol=1e-4 * np.max(np.abs(expected)))


def check_samples(found: Mapping[str, Tensor], rows: Sequence[int], samples: Sequence[Mapping[str, Any]]) -> None:
    names = {"mean": "means", "scale": "scales", "rot_xyzw": "rotations_xyzw", "dc": "harmonics_dc"}
    for row, sample in zip(rows, samples, strict=True):
        for name, attribute in names.items():
            np.testing.assert_allclose(found[attribute][row].numpy(), sample[name], rtol=1e-3, atol=2e-4, err_msg=name)
        assert found["opacities"][row].item() == pytest.approx(sample["opacity"], abs=2e-4)
