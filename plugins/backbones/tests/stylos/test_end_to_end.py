"""The whole network, from pixels to styled Gaussians, against the published implementation."""

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.types import Gaussians, Scene, StyleEmbedding, Views
from anystyle_backbones.heads import decoded_maps
from anystyle_backbones.stylos import Stylos, StylosStyle
from anystyle_backbones.stylos.heads import StylosBranch
from anystyle_backbones.stylos.keys import StylosCheckpoints
from tests.support import anysplat_reference, oracle, stylos_reference

CHECKPOINTS = StylosCheckpoints()
VARIANTS = ("global", "frame", "hybrid")
CASES = [name for name in stylos_reference.record()["tiny"] if name.startswith("tiny_")]


@dataclass
class Network:
    backbone: Stylos
    branch: StylosBranch
    encoder: StylosStyle
    scenes: dict[str, Scene] = field(default_factory=dict)

    def encoded(self, name: str, case: Mapping[str, Any]) -> Scene:
        """The scene of a case, encoded once."""
        if name not in self.scenes:
            self.backbone.adapter.voxel_size = case["voxel_size"]
            with torch.no_grad():
                self.scenes[name] = self.backbone.encode(Views(oracle.image(case["inputs"]["images"])))
        return self.scenes[name]

    def embed(self, images: Tensor) -> StyleEmbedding:
        with torch.no_grad():
            vector, tokens = self.encoder.embed_images(images), self.encoder.embed_tokens(images)
        return StyleEmbedding(vector, vector, tokens=tokens)


def build(shapes: Mapping[str, Tensor], **taps: Sequence[int]) -> Network:
    """The network that a checkpoint's names and shapes tell, without memory of its own, with the golden's weights."""
    state = stylos_reference.weights(shapes)
    config = CHECKPOINTS.config(state)
    options = {name.partition(".")[2]: config[name] for name in config if name.startswith("backbone.")}
    encoding = {name.partition(".")[2]: config[name] for name in config if name.startswith("style_encoder.")}
    with torch.device("meta"):
        backbone = Stylos(**(options | taps))
        branch, encoder = backbone.make_branch(), StylosStyle(**encoding, resolution=None)
    backbone.load_reference(state)
    CHECKPOINTS.load("branch", branch, state)
    encoder.load_published(state)
    assert isinstance(branch, StylosBranch)
    return Network(backbone.freeze(), branch.eval(), encoder.requires_grad_(False).eval())


@cache
def tiny(variant: str) -> Network:
    return build(stylos_reference.tiny_shapes(variant), **stylos_reference.tiny_taps())


def watched(branch: StylosBranch, scene: Scene, embedding: StyleEmbedding) -> dict[str, Tensor]:
    """What the first block that runs computes on the way, and the raw map, in the golden's words."""
    block = next(iter(branch.aggregator.layers[0].values()))
    seen: dict[str, Tensor] = {}

    def keep(module: nn.Module, name: str, value: Callable[[Any, Any], Tensor]) -> Any:
        def hook(_: nn.Module, given: Any, result: Any) -> None:
            seen.setdefault(name, value(given, result))

        return module.register_forward_hook(hook)

    hooks = [
        keep(block.kvnorm1, "style_tokens", lambda given, _: given[0]),
        keep(block.qnorm1, "after_self_attention", lambda given, _: given[0]),
        keep(block.ls2, "cross_attention_update", lambda given, result: result - given[0]),
        keep(block.ls3, "mlp_update", lambda given, result: result - given[0]),
        keep(block, "output", lambda _, result: result),
    ]
    with torch.no_grad():
        levels = branch.aggregator(scene.stem, embedding.tokens)
        raw = decoded_maps(branch.gaussian_head, levels, scene.views.size, chunk=branch.chunk).movedim(-1, 2)
        assert torch.equal(raw[:, :, :3].movedim(2, -1)[..., None], branch(scene, embedding).color)
    for hook in hooks:
        hook.remove()
    seen["raw_style"] = raw
    return seen


def styled(network: Network, scene: Scene, embedding: StyleEmbedding) -> Gaussians:
    with torch.no_grad():
        attributes = scene.attributes.with_(network.branch(scene, embedding), network.branch.styled)
        return network.backbone.adapter(attributes, scene.geometry, scene.clusters)


def check_colors(scene: Scene, gaussians: Gaussians, records: Sequence[Mapping[str, Any]], voxel_size: float) -> None:
    assert scene.clusters is not None
    for batch, record in enumerate(records):
        colors = gaussians.harmonics[batch, scene.clusters.valid[batch], 0]
        assert len(colors) == record.get("n_voxels", len(colors))
        anysplat_reference.check_moments(colors, record["harmonics_dc"])
        samples = record.get("samples", ())
        rows = anysplat_reference.rows_of(scene, batch, [sample["voxel"] for sample in samples], voxel_size)
        for row, sample in zip(rows, samples, strict=True):
            expected = torch.tensor(sample["dc"])
            torch.testing.assert_close(gaussians.harmonics[batch, row, 0], expected, rtol=1e-3, atol=2e-4)


def check_whole(scene: Scene, gaussians: Gaussians, records: Sequence[Mapping[str, Any]], voxel_size: float) -> None:
    """Every attribute; numbers of voxels exactly."""
    assert scene.clusters is not None
    anysplat_reference.check_gaussians(scene, gaussians, records, voxel_size)
    for batch, record in enumerate(records):
        valid = scene.clusters.valid[batch]
        assert int(valid.sum()) == record["n_voxels"] and len(valid) == record["padded_to"]
        assert scene.clusters.index[batch].numel() == record["n_pixels"]
        counts = scene.clusters.index[batch].bincount()
        assert int(counts.max()) == record["max_points_per_voxel"]
        axes = matrix_from_wxyz(gaussians.rotations[batch, valid]) * gaussians.scales[batch, valid, None]
        anysplat_reference.check_moments((axes @ axes.mT).flatten(1), record["stats"]["covariances"])
        rows = anysplat_reference.rows_of(scene, batch, [one["voxel"] for one in record["samples"]], voxel_size)
        assert [int(counts[row]) for row in rows] == [one["n_points"] for one in record["samples"]]


def check_style(network: Network, scene: Scene, embedding: StyleEmbedding, record: Mapping[str, Any]) -> None:
    seen = watched(network.branch, scene, embedding)
    anysplat_reference.check(seen["raw_style"], record["raw_style"])
    means = seen["raw_style"].mean((0, 1, 3, 4))
    torch.testing.assert_close(
        means, torch.tensor(record.get("raw_style_channel_mean", means.tolist())), rtol=1e-4, atol=1e-5
    )
    for name, expected in record.get("first_block", {}).items():
        anysplat_reference.check(seen[name], expected)
    if "style_tokens" in record:
        anysplat_reference.check(seen["style_tokens"], record["style_tokens"])
    if "style_layers" in record:
        with torch.no_grad():
            levels = network.branch.aggregator(scene.stem, embedding.tokens)
        for tokens, expected in zip(levels, record["style_layers"], strict=True):
            anysplat_reference.check(tokens.data, expected)


def check_variant(network: Network, name: str, case: Mapping[str, Any], variant: str) -> None:
    record, scene = case[variant], network.encoded(name, case)
    pictures = {
        "style": oracle.image(case["inputs"]["style_image"])[:, 0],
        "second_style": oracle.image(case["inputs"]["second_style_image"])[:, 0],
        "first_view_as_style": scene.views.images[:, 0],
    }
    for what, picture in pictures.items():
        expected, embedding = record if what == "style" else record.get(what), network.embed(picture)
        if expected is None:
            continue
        check_style(network, scene, embedding, expected)
        gaussians = styled(network, scene, embedding)
        if "stats" in expected["gaussians"][0]:
            check_whole(scene, gaussians, expected["gaussians"], case["voxel_size"])
        else:
            check_colors(scene, gaussians, expected["gaussians"], case["voxel_size"])


def check_base(network: Network, name: str, case: Mapping[str, Any]) -> None:
    scene, base = network.encoded(name, case), case["base"]
    anysplat_reference.check_scene(network.backbone, scene, base)
    picture = oracle.image(case["inputs"]["style_image"])
    anysplat_reference.check(picture, base["style_image"])
    anysplat_reference.check(network.embed(picture[:, 0]).tokens.data, base["style_patch_tokens"])
    check_geometry(scene, base)


def check_geometry(scene: Scene, record: Mapping[str, Any]) -> None:
    raw = torch.cat([anysplat_reference.raw_maps(scene.attributes)[:, :, channels] for channels in (GEOMETRY, LAST)], 2)
    anysplat_reference.check(raw, record["raw_geometry"])
    means = raw.mean((0, 1, 3, 4))
    torch.testing.assert_close(means, torch.tensor(record["raw_geometry_channel_mean"]), rtol=1e-4, atol=1e-5)


GEOMETRY, LAST = slice(0, 8), slice(-1, None)


@pytest.mark.parametrize("case", CASES)
def test_what_does_not_depend_on_style(case: str) -> None:
    check_base(tiny("global"), case, stylos_reference.record()["tiny"][case])


@pytest.mark.parametrize(
    ("case", "variant"),
    [(case, variant) for case in CASES for variant in VARIANTS if variant in stylos_reference.record()["tiny"][case]],
)
def test_colours(case: str, variant: str) -> None:
    check_variant(tiny(variant), case, stylos_reference.record()["tiny"][case], variant)


def test_the_demos_network() -> None:
    record = stylos_reference.record()["tiny"]["demo_quick_inference"]
    assert len(stylos_reference.tiny_shapes("demo")) == record["n_keys"]
    network = tiny("demo")
    case = stylos_reference.record()["tiny"][record["case"]] | {"voxel_size": record["voxel_size"]}
    scene = network.encoded(record["case"], case)
    check_geometry(scene, record)
    style = network.embed(oracle.image(case["inputs"]["style_image"])[:, 0])
    check_whole(scene, styled(network, scene, style), record["gaussians"], record["voxel_size"])
    anysplat_reference.check(watched(network.branch, scene, style)["raw_style"], case["global"]["raw_style"])


def exchanged(state: Mapping[str, Tensor], one: str, other: str) -> dict[str, Tensor]:
    """Weights whose names two words are exchanged in."""
    found = {}
    for key, tensor in state.items():
        found[key.replace(one, "~").replace(other, one).replace("~", other)] = tensor
    return found


MISTAKES: dict[str, Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]] = {
    "values before keys": lambda s: {k: t.roll(len(t) // 2, 0) if "kv_proj" in k else t for k, t in s.items()},
    "norms": lambda s: exchanged(s, ".qnorm1.", ".kvnorm1."),
    "layer scales": lambda s: exchanged(s, ".ls1.", ".ls2."),
    "registers": lambda s: {k: t * 0 if k.endswith("register_token") else t for k, t in s.items()},
}


@pytest.mark.parametrize("mistake", [*MISTAKES, "positions", "another style"])
def test_a_mistake_is_far_from_the_golden(mistake: str) -> None:
    network, name = tiny("global"), CASES[0]
    case = stylos_reference.record()["tiny"][name]
    branch, scene = copy.deepcopy(network.branch), network.encoded(name, case)
    branch.load_state_dict(MISTAKES.get(mistake, dict)(branch.state_dict()))
    picture = "second_style_image" if mistake == "another style" else "style_image"
    style = network.embed(oracle.image(case["inputs"][picture])[:, 0])
    if mistake == "positions":
        assert style.tokens is not None
        style = replace(style, tokens=replace(style.tokens, grid=style.tokens.grid[::-1]))
    record = case["global"]["raw_style"]
    raw = watched(branch, scene, style)["raw_style"].flatten()[record["idx"]]
    assert (raw - torch.tensor(record["val"])).abs().max() > 20 * oracle.tolerance(record)


@pytest.mark.slow
def test_the_published_network() -> None:
    full = stylos_reference.record()["full"]
    network = build(stylos_reference.expanded(full["keys"]))
    for name, case in full.items():
        if re.match("full_", name):
            check_base(network, name, case)
            check_variant(network, name, case, "global")
