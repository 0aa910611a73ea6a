"""The whole network, from pixels to Gaussians, against the published implementation."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from anystyle.geometry.projection import covariances
from anystyle.types import Scene, StyleEmbedding, Views
from anystyle_backbones.styl3r import Styl3r, Styl3rStyle
from anystyle_backbones.styl3r.heads import GaussianHead, GeometryHead, Styl3rBranch
from anystyle_backbones.styl3r.keys import Styl3rCheckpoints
from anystyle_backbones.styl3r.transformer import Aggregator, Embedder, TokenStylizer, symmetric
from tests.support import oracle
from tests.support import styl3r_reference as reference

GOLDEN = reference.record()
Parts = tuple[Styl3r, Styl3rBranch, Styl3rStyle]


def load(state: Mapping[str, Tensor], options: Mapping[str, Any], encoder_options: Mapping[str, Any]) -> Parts:
    with torch.device("meta"):
        backbone, encoder = Styl3r(**options), Styl3rStyle(resolution=None, **encoder_options)
        branch = backbone.make_branch()
    backbone.load_reference(state)
    Styl3rCheckpoints().load("branch", branch, state)
    encoder.load_published(state)
    return backbone.freeze(), branch.requires_grad_(False).eval(), encoder.requires_grad_(False).eval()


@pytest.fixture(scope="module")
def tiny() -> Parts:
    return load(reference.tiny_weights(), reference.TINY, reference.DIMS)


@contextmanager
def watched(modules: Mapping[str, nn.Module]) -> Iterator[dict[str, tuple[Tensor, Tensor]]]:
    """The input and output of each module when it is called for the first time."""
    seen: dict[str, tuple[Tensor, Tensor]] = {}
    with ExitStack() as hooks:
        for name, module in modules.items():

            def keep(_module: nn.Module, given: Any, output: Any, name: str = name) -> None:
                seen.setdefault(name, (given[0], output))

            hooks.enter_context(module.register_forward_hook(keep))
        yield seen


@torch.no_grad()
def check_case(parts: Parts, record: Mapping[str, Any]) -> None:
    backbone = parts[0]
    head, geometry_head, aggregator, embedder = (
        backbone.gaussian_head, backbone.geometry_head, backbone.aggregator, backbone.embedder
    )  # fmt: skip
    assert isinstance(head, GaussianHead) and isinstance(geometry_head, GeometryHead)
    assert isinstance(aggregator, Aggregator) and isinstance(embedder, Embedder)
    images = oracle.image(record["inputs"]["images"])
    batch, views, _, height, width = images.shape
    modules = {"encoder": embedder.encoder.blocks[0], "first": aggregator.first[0], "others": aggregator.others[0]}
    modules |= {f"head1_reassembled_{level}": geometry_head.first.reduce[level] for level in range(4)}
    modules |= {f"head1_fused_{level}": geometry_head.first.fusions[level] for level in range(4)}
    modules |= {"decoder_embed": aggregator.embed, "image": head.first.direct}
    with watched(modules) as seen:
        scene = backbone.encode(Views(images, cameras=reference.cameras(record["inputs"], (height, width))))
    assert scene.clusters is None
    gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    stem, block = (each.unflatten(0, (batch, views)).roll(-1, dims=2) for each in seen["encoder"])
    attributes, others = scene.attributes, seen["others"][1].unflatten(0, (batch, -1))
    values = {
        "stem": stem,
        "encoder_block_0": block,
        "encoder": scene.stem.data.roll(-1, dims=2),
        "decoder_embed": seen["decoder_embed"][1].roll(-1, dims=2),
        "decoder_1": torch.cat([seen["first"][1][:, None], others], dim=1)[:, :, 1:],
        **{f"decoder_{layer}": tokens.patches for layer, tokens in scene.features.items() if layer},
        **{name: output for name, (_, output) in seen.items() if name.startswith("head1_")},
        "gs_head_image_features": seen["image"][1].relu(),
        "points_raw": geometry_head.raw(scene.features, images).movedim(-1, 2),
        "points": scene.geometry.points(),
        "opacity_logits": attributes.opacity,
        "scales_raw": attributes.scale.movedim(-1, 2),
        "rotations_raw": attributes.rotation.movedim(-1, 2),
        "means": gaussians.means,
        "scales": gaussians.scales,
        "rotations_xyzw": gaussians.rotations.roll(-1, dims=-1),
        "opacities": gaussians.opacities,
        "covariances": covariances(gaussians.rotations, gaussians.scales),
    }
    for name, expected in record["shared"].items():
        oracle.check(values[name], expected, name)
    oracle.check(gaussians.harmonics.mT, record["unstyled"]["harmonics"], "harmonics")
    check_style(parts, scene, symmetric(images[:, 0]), record["unstyled"])
    check_style(parts, scene, oracle.image(record["inputs"]["style"]), record["stylized"])


@torch.no_grad()
def check_style(parts: Parts, scene: Scene, pictures: Tensor, record: Mapping[str, Any]) -> None:
    """A style in the pixels' range as it is given."""
    backbone, branch, encoder = parts
    assert isinstance(branch.aggregator, TokenStylizer)
    with watched({"encoder": encoder.encoder.blocks[0], "block": branch.aggregator.blocks[0]}) as seen:
        tokens = encoder.embed_tokens(pictures)
        vector = encoder.embed_images(pictures)
        attributes = branch(scene, StyleEmbedding(vector, vector, tokens=tokens))
    features = branch.aggregator(scene.features[0], tokens)
    torch.testing.assert_close(vector, tokens.data.mean((1, 2)))
    values = {
        "style_stem": seen["encoder"][0],
        "style_tokens": tokens.data[:, 0],
        "style_memory": branch.aggregator.embed(tokens.data[:, 0]),
        "stylizer_block_0": seen["block"][1].unflatten(1, scene.stem.data.shape[1:3]).roll(-1, dims=2),
        **{f"stylized_{layer}": each.patches for layer, each in features.items() if layer},
        "appearance_raw": attributes.color.flatten(4).movedim(-1, 2),
        "harmonics": backbone.adapter(attributes, scene.geometry, scene.clusters).harmonics.mT,
    }
    assert values.keys() == record.keys()
    for name, expected in record.items():
        oracle.check(values[name], expected, name)


def cases(network: str) -> list[str]:
    """All but the portrait."""
    return [name for name, case in GOLDEN[network].items() if isinstance(case, dict) and "shared" in case]


@pytest.mark.parametrize("case", cases("tiny"))
def test_tiny(tiny: Parts, case: str) -> None:
    check_case(tiny, GOLDEN["tiny"][case])


@pytest.mark.parametrize("case", [name for name in GOLDEN["tiny"] if name.startswith("portrait")])
@torch.no_grad()
def test_portraits_are_in_the_order_of_their_pixels(tiny: Parts, case: str) -> None:
    backbone, record = tiny[0], GOLDEN["tiny"][case]
    images = oracle.image(record["inputs"]["images"])
    views = Views(images, cameras=reference.cameras(record["inputs"], (images.shape[-2], images.shape[-1])))
    scene = backbone.encode(views)
    gaussians = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    oracle.check(gaussians.means, record["means_in_row_major_order"], "means")
    oracle.check(gaussians.opacities, record["opacities"], "opacities")
    oracle.check(gaussians.harmonics.mT, record["harmonics"], "harmonics")
    with pytest.raises(AssertionError):
        oracle.check(gaussians.means, record["means_as_released"], "means as released")
    turned = scene.geometry.points().transpose(2, 3).flatten(1, 3)
    oracle.check(turned, record["means_as_released"], "means as released")


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_released() -> None:
    shapes = {name: torch.empty(shape, device="meta") for name, shape in reference.shapes("released").items()}
    parts = load(reference.weights(shapes), {}, {})
    for case in cases("released"):
        check_case(parts, GOLDEN["released"][case])
