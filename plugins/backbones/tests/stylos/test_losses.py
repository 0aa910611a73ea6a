"""The objective's terms against the published implementation."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle.testing.inputs import stylization
from anystyle.testing.oracle import fill_named, hashed
from anystyle.types import Renders, Style, Stylization, Views
from anystyle.vision.vgg import AdainVGG
from anystyle_backbones.stylos.losses import AdainVoxels, DiagonalVariation
from tests.support import anysplat_reference, oracle, stylos_reference

RECORD = stylos_reference.record()["losses"]
POOLS = {"image": "image", "scene": "scene", "3d": "voxels"}
LAYER_WEIGHTS = {"co3d": (16, 8, 4, 2, 1), "dl3dv": (1, 1, 1, 1, 1)}


def given(name: str) -> Tensor:
    """An input ``IMG(index, shape)`` or ``in(index, shape, low, high)``."""
    text = RECORD["inputs"][name]
    if text.startswith("IMG"):
        return oracle.image(text)
    index, shape, low, high = re.fullmatch(r"in\((\d+),\[(.*)\],(.*),(.*)\)", text).groups()
    return hashed(int(index), [int(side) for side in shape.split(",")], float(low), float(high))


@pytest.fixture(scope="module")
def result() -> Stylization:
    photographs = given("content")
    made = stylization(*photographs.shape[:2])
    points, confidence = given("points"), given("conf")
    geometry = replace(made.scene.geometry, depth=points[..., 2], confidence=confidence.exp(), pointmap=points)
    height, width = confidence.shape[2:]
    cut = made.scene.attributes.map(lambda tensor: tensor[:, :, :height, :width])
    return replace(
        made,
        views=Views(photographs),
        style=Style(image=given("style")[:, 0]),
        scene=replace(made.scene, geometry=geometry, attributes=replace(cut, confidence=confidence)),
        renders=Renders(given("rendered"), points[..., 2], torch.ones_like(confidence)),
    )


@pytest.fixture(scope="module", autouse=True)
def _vgg(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder: Path = tmp_path_factory.mktemp("vgg")
    shapes = {f"{index}.{leaf}": tensor for (index, leaf), tensor in file_shapes().items()}
    assert len(shapes) == RECORD["n_keys_vgg"]
    fill = RECORD["vgg_fill"]
    torch.save(fill_named(shapes, fill["rules"], fill["offset"]), folder / "vgg_normalised.pth")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ANYSTYLE_WEIGHTS", str(folder))
        yield


def file_shapes() -> dict[tuple[int, str], Tensor]:
    """The published file, which goes on to relu5_4."""
    shapes = {}
    for key, tensor in AdainVGG().state_dict().items():
        index, leaf = key.split(".")
        shapes[int(index), leaf] = tensor
    for index in (45, 48, 51):
        shapes |= {(index, leaf): shapes[42, leaf] for leaf in ("weight", "bias")}
    return shapes


def loss(case: str) -> AdainVoxels:
    data, pool = case.split("/")
    voxel_size = RECORD["inputs"]["voxel_size"]
    return AdainVoxels(pool=POOLS[pool], layer_weights=LAYER_WEIGHTS[data], voxel_size=voxel_size)


def test_features(result: Stylization) -> None:
    found = loss("co3d/3d").features(result.renders.color.flatten(0, 1))
    for features, expected in zip(found, RECORD["features_of_rendered"], strict=True):
        anysplat_reference.check(features, expected)


@pytest.mark.parametrize("case", [name for name in RECORD if "/" in name])
def test_statistics_and_content(result: Stylization, case: str) -> None:
    term, expected = loss(case), RECORD[case]
    with torch.no_grad():
        style, content = term.terms(result, term.features(result.renders.color.flatten(0, 1)))
        total = term(result)
    assert style.item() == pytest.approx(expected["style"], rel=1e-3)
    assert content.item() == pytest.approx(expected["content"], rel=1e-3)
    assert total.item() == pytest.approx(expected["total"], rel=1e-3)


def test_variation(result: Stylization) -> None:
    term = DiagonalVariation()
    assert (term.weight * term(result)).item() == pytest.approx(RECORD["total_variance_weight_10"], rel=1e-3)
