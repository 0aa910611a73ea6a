"""The whole network, from pixels to Gaussians, against the published implementation."""

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named, hashed
from anystyle.types import Attributes, Geometry
from anystyle_backbones.worldmirror import WorldMirror
from anystyle_backbones.worldmirror.heads import GeometryHead
from tests.support import worldmirror_reference as reference
from tests.support.oracle import check

GOLDEN = reference.record()
CASES = [name for name, one in GOLDEN["tiny"].items() if isinstance(one, dict) and "records" in one]


def tiny(**options: Any) -> WorldMirror:
    backbone = WorldMirror(**(reference.TINY | options))
    backbone.load_reference(reference.tiny_weights())
    backbone.freeze()
    return backbone


def check_predictions(backbone: WorldMirror, case: Mapping[str, Any]) -> tuple[Geometry, Tensor]:
    """Hold all that does not depend on fusion against the records; returns geometry and images."""
    records, images = case["records"], reference.views(case).images
    head = backbone.geometry_head
    assert isinstance(head, GeometryHead)
    stem = backbone.embedder(images)
    check(stem.data, records["stem"])
    check(stem.patches, records["patches"])
    features = backbone.aggregator(stem)
    for place, layer in enumerate(backbone.aggregator.taps):
        check(features[layer].data, records[f"features_{place}"])
    check(head.camera(features[backbone.aggregator.taps[-1]].data[:, :, 0]), records["passes"])
    geometry = head(features, images)
    check(geometry.cameras.world_from_camera, records["poses"])
    check(geometry.cameras.intrinsics, records["intrinsics"])
    check(geometry.depth, records["depth"])
    check(geometry.confidence, records["depth_conf"])
    depth, confidence = head.decoded(head.placing, features, images).exp().unbind(-1)
    check(depth, records["gs_depth"])
    check(1 + confidence, records["gs_depth_conf"])
    check(geometry.points().flatten(1, 3), records["pixel_means"])
    return geometry, images


def check_pixels(attributes: Attributes, geometry: Geometry, images: Tensor, backbone: WorldMirror, case: Any) -> None:
    """Hold attributes and Gaussians that are not fused against the records."""
    records = case["records"]
    check(reference.raw_maps(attributes, images), records["gs_params"])
    assert attributes.confidence is not None
    check(attributes.confidence.flatten(1).sigmoid(), records["pixel_weights"])
    gaussians = backbone.adapter(attributes, geometry, backbone.adapter.cluster(geometry, attributes))
    check(gaussians.means, records["pixel_means"])
    check(gaussians.rotations, records["pixel_quats"])
    check(gaussians.scales, records["pixel_scales"])
    check(gaussians.opacities, records["pixel_opacities"])
    check(gaussians.harmonics, records["pixel_sh"])


@pytest.mark.parametrize("name", CASES)
@torch.no_grad()
def test_tiny(name: str) -> None:
    case, backbone = GOLDEN["tiny"][name], tiny(fuse=False)
    geometry, images = check_predictions(backbone, case)
    check_pixels(backbone.encode(reference.views(case)).attributes, geometry, images, backbone, case)


@pytest.mark.parametrize("name", CASES)
@torch.no_grad()
def test_fused(name: str) -> None:
    """By counts and means: a point at a voxel's border may fall on either side."""
    case, backbone = GOLDEN["tiny"][name], tiny()
    scene = backbone.encode(reference.views(case))
    gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    assert scene.clusters is not None
    for row, expected in enumerate(case["voxels"]):
        valid = scene.clusters.valid[row]
        assert int(valid.sum()) == pytest.approx(expected["count"], rel=1e-3)
        for ours, name in NAMES.items():
            mean = getattr(gaussians, ours)[row, valid].double().abs().mean().item()
            assert mean == pytest.approx(expected["abs_mean"][name], rel=1e-3), name


NAMES = {"means": "means", "rotations": "quats", "scales": "scales", "opacities": "opacities", "harmonics": "sh"}


def test_merging() -> None:
    """The adapter alone, on points that are given: every sample."""
    shape = (2, 1, 20, 30)
    attributes = Attributes(
        opacity=hashed(455, shape, -4, 4),
        scale=hashed(453, (*shape, 3), -6, 0),
        rotation=hashed(452, (*shape, 4), -1, 1),
        color=hashed(454, (*shape, 1, 3), -1, 1).mT,
        confidence=hashed(455, shape, -4, 4),
    )
    backbone = tiny()
    with torch.no_grad():
        cameras = backbone.encode(reference.views({"images": [1, [2, 1, 3, 14, 14]]})).cameras
        points = hashed(451, (*shape, 3), -0.2, 0.2)
        geometry = Geometry(cameras, torch.ones(shape), torch.ones(shape), pointmap=points)
        clusters = backbone.adapter.cluster(geometry, attributes)
        gaussians = backbone.adapter(attributes, geometry, clusters)
    assert clusters is not None
    for row, records in enumerate(GOLDEN["tiny"]["merging"]):
        for ours, name in NAMES.items():
            check(getattr(gaussians, ours)[row, clusters.valid[row]], records[name])


@pytest.mark.parametrize(("name", "known"), [("known", "cameras"), ("known", "lenses"), ("known_12", "cameras")])
@torch.no_grad()
def test_known_cameras(name: str, known: str) -> None:
    case, backbone = GOLDEN["tiny"][name], tiny(known=known)
    scene = backbone.encode(reference.views(case))
    check(scene.stem.data, case[known]["stem"])
    last = scene.features[5].data[:, :, 0]
    check(backbone.geometry_head.camera(last), case[known]["passes"])
    if "depth" in case[known]:
        check(scene.geometry.depth, case[known]["depth"])


@torch.no_grad()
def test_cameras_are_not_read_unless_asked_for() -> None:
    case = GOLDEN["tiny"]["known"]
    check(tiny().encode(reference.views(case)).stem.data, GOLDEN["tiny"]["v3_42x70"]["records"]["stem"])


@pytest.mark.slow
@torch.no_grad()
def test_full() -> None:
    with torch.device("meta"):
        backbone = WorldMirror(fuse=False)
    shapes, rules = reference.shapes("full"), GOLDEN["fill"]["rules"]
    backbone.load_reference(fill_named(shapes, rules))
    backbone.freeze()
    case = GOLDEN["full"]["v2_56x84"]
    geometry, images = check_predictions(backbone, case)
    attributes = backbone.gaussian_head(backbone.aggregator(backbone.embedder(images)), images)
    check_pixels(attributes, geometry, images, backbone, case)
