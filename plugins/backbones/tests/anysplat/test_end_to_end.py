"""The whole method, from pixels to styled Gaussians, against the published implementation."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from anystyle.branch import StyleBranch
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.placements import Full, Head
from anystyle.testing.oracle import fill_named
from anystyle.types import Attributes, Scene, Site, StyleEmbedding, Tokens, Views
from anystyle_backbones.anysplat import AnySplat, keys
from tests.support import anysplat_reference as reference
from tests.support.oracle import golden, image

CHECKPOINTS = keys.AnySplatCheckpoints()
PLACEMENTS = {"head": Head(), "agg": Full()}
STYLED = {
    "none": ("color",),
    "colors-rotations": ("rotation", "color"),
    "no-pos": ("opacity", "scale", "rotation", "color"),
}
# Published tensors that our modules have no use for, with their shapes.
SHAPES = {"weight": (512, 512), "bias": (512,)}
TEXT_ADAPTER = {f"text_adapter.mlp.{layer}.{kind}": shape for layer in (0, 2) for kind, shape in SHAPES.items()}
TRUNK = {"native_resolution": 70, "dim": 64, "embed_depth": 2, "depth": 6, "heads": 4, "taps": (1, 3, 4, 5)}
CHANNELS = {"depth_features": 32, "depth_channels": (8, 12, 16, 16), "gaussian_channels": (8, 12, 16, 16)}
TINY = TRUNK | CHANNELS | {"camera_depth": 2, "camera_heads": 4, "voxel_size": 0.04}
TINY_HIDDEN = {"head/direct": 16}
FULL_HIDDEN = {"head/direct": 256}


@dataclass(frozen=True)
class Network:
    """A backbone and a branch for each placement, with the golden's weights."""

    golden: Mapping[str, Any]
    backbone: AnySplat
    branches: Mapping[str, StyleBranch]
    state: Mapping[str, Tensor]
    scenes: dict[str, Scene] = field(default_factory=dict)


def build(
    record: Mapping[str, Any], rules: Sequence[Any], options: Mapping[str, Any], hidden: Mapping[str, int], width: int
) -> Network:
    def injector(site: Site) -> ZeroConv:
        return ZeroConv(dim=site.dim, style_dim=512, hidden=hidden.get(site.name, width))

    with torch.device("meta"):
        backbone = AnySplat(**options)
        branches = {
            name: StyleBranch(backbone, sites=placement.select(backbone.sites), make_injector=injector)
            for name, placement in PLACEMENTS.items()
        }
    shapes = published(backbone.state_dict(), keys.backbone_names)
    shapes |= published(branches["agg"].state_dict(), keys.branch_names)
    unused = {"aggregator.patch_embed.mask_token": (1, backbone.aggregator.dim)} | TEXT_ADAPTER
    shapes |= {name: torch.empty(shape, device="meta") for name, shape in unused.items()}
    assert len(shapes) == record["n_keys"] and sum(map(Tensor.numel, shapes.values())) == record["n_params"]
    state = fill_named(shapes, rules)
    backbone.load_reference(state)
    CHECKPOINTS.load("branch", branches["agg"], state)
    head = {name: tensor for name, tensor in state.items() if not name.startswith("aggregator_injection.")}
    CHECKPOINTS.load("branch", branches["head"], head)
    return Network(record, backbone.freeze(), branches, state)


def published(state: Mapping[str, Tensor], names: Any) -> dict[str, Tensor]:
    return {name: state[key] for key, name in names(list(state)).items()}


@pytest.fixture(scope="module")
def tiny() -> Network:
    file = golden("golden_e2e_tiny")
    network = build(file["tiny"], file["fill"]["rules"], TINY, TINY_HIDDEN, 32)
    assert set(network.state) == set(file["tiny"]["keys"])
    return network


def embedding_of(record: Mapping[str, Any]) -> StyleEmbedding:
    index, rows = re.search(r"in\((\d+),\[(\d+),512\]", record["inputs"]["z"]).groups()
    vector = reference.style_vector(int(index), int(rows))
    return StyleEmbedding(vector, vector)


def check_raw(attributes: Attributes, record: Mapping[str, Any], name: str) -> None:
    raw = reference.raw_maps(attributes)
    reference.check(raw, record[name])
    means = raw.double().mean((0, 1, 3, 4)).numpy()
    np.testing.assert_allclose(means, record[f"{name}_channel_mean"], rtol=1e-4, atol=1e-5)


def encoded(network: Network, case: str) -> Scene:
    """The scene of a case, encoded once."""
    if case not in network.scenes:
        record = network.golden[case]
        network.backbone.adapter.voxel_size = record["voxel_size"]
        with torch.no_grad():
            network.scenes[case] = network.backbone.encode(Views(image(record["inputs"]["images"])))
    return network.scenes[case]


def check_case(network: Network, case: str) -> None:
    record = network.golden[case]
    voxel_size, embedding, scene = record["voxel_size"], embedding_of(record), encoded(network, case)
    with torch.no_grad():
        reference.check_scene(network.backbone, scene, record["base"])
        check_raw(scene.attributes, record["base"], "raw_base")
        unstyled = network.backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
        reference.check_gaussians(scene, unstyled, record["unstyled"]["gaussians"], voxel_size)
        for placement, branch in network.branches.items():
            if branch.aggregator is not None:
                features = branch.aggregator(scene.stem, injected(branch, embedding.vector))
                for tokens, layer in zip(features.values(), record[f"{placement}/none"]["style_layers"], strict=True):
                    reference.check(tokens.data, layer)
            styled = every_degree(branch, scene, embedding)
            check_raw(styled, record[f"{placement}/none"], "raw_style")
            for name, attributes in STYLED.items():
                mixed = scene.attributes.with_(styled.with_degree(branch.sh_degree), attributes)
                gaussians = network.backbone.adapter(mixed, scene.geometry, scene.clusters)
                reference.check_gaussians(scene, gaussians, record[f"{placement}/{name}"]["gaussians"], voxel_size)


def injected(branch: StyleBranch, vector: Tensor) -> Any:
    def inject(site: str, tokens: Tokens) -> Tokens:
        return branch.injectors[site](tokens, vector) if site in branch.injectors else tokens

    return inject


def every_degree(branch: StyleBranch, scene: Scene, embedding: StyleEmbedding) -> Attributes:
    """What the styled head predicts, with the harmonics that the branch drops."""
    degree, branch.sh_degree = branch.sh_degree, 4
    attributes = branch(scene, embedding)
    branch.sh_degree = degree
    return attributes


@pytest.mark.parametrize("case", ["tiny_v3_56x84", "tiny_b2_v2_70x70"])
def test_a_small_network(tiny: Network, case: str) -> None:
    check_case(tiny, case)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_fresh_branch_changes_nothing(tiny: Network, placement: str) -> None:
    record = tiny.golden["zero_proj_zero"][f"{placement}_copied_base_and_zero_proj"]
    embedding, scene = embedding_of(tiny.golden["tiny_v3_56x84"]), encoded(tiny, "tiny_v3_56x84")
    sites = PLACEMENTS[placement].select(tiny.backbone.sites)
    branch = StyleBranch(tiny.backbone, sites=sites, make_injector=lambda site: ZeroConv(dim=site.dim, style_dim=512))
    with torch.no_grad():
        styled = branch(scene, embedding)
        assert record["max_abs_raw_style_minus_raw_base"] == 0
        for name in ("opacity", "scale", "rotation"):
            assert torch.equal(getattr(styled, name), getattr(scene.attributes, name))
        assert torch.equal(styled.color, scene.attributes.color[..., :1])
        gaussians = tiny.backbone.adapter(styled, scene.geometry, scene.clusters)
    colors = gaussians.harmonics[0, :, 0].double()
    np.testing.assert_allclose(colors.mean(0).numpy(), record["dc"]["mean"], rtol=1e-4)
    np.testing.assert_allclose(colors.square().mean(0).sqrt().numpy(), record["dc"]["rms"], rtol=1e-4)


@pytest.mark.slow
def test_the_published_network() -> None:
    file = golden("golden_e2e")
    network = build(file["full"], file["fill"]["rules"], {}, FULL_HIDDEN, 1024)
    for case in ("full_v2_56x84", "full_v3_70x70"):
        check_case(network, case)
