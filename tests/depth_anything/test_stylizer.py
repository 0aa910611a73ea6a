"""Style on this backbone works as on any other, in every placement."""

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from anystyle.branch import StyleBranch
from anystyle.contracts import Placement
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.placements.aggregator import Aggregator
from anystyle.placements.full import Full
from anystyle.placements.head import Head
from anystyle.renderers.torch import TorchRenderer
from anystyle.stylizer import Stylizer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Gaussians, Views
from anystyle_depth_anything import DepthAnything
from oracle import smooth_image

PLACEMENTS: dict[str, Placement] = {"head": Head(), "aggregator": Aggregator(), "full": Full()}
VIEWS = Views(smooth_image(1, (1, 3, 3, 28, 42)))


def stylizer(placement: Placement, **options: object) -> Stylizer:
    torch.manual_seed(0)
    backbone = DepthAnything(**(DepthAnything.example(Path()) | {"reference": "middle"} | options))  # type: ignore[arg-type]
    encoder = ToyStyleEncoder()
    branch = StyleBranch(
        backbone,
        sites=placement.select(backbone.sites),
        make_injector=lambda site: ZeroConv(dim=site.dim, style_dim=encoder.dim, hidden=8),
        sh_degree=1,
    )
    return Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=TorchRenderer()).eval()


@torch.no_grad()
def grown(made: Stylizer) -> Stylizer:
    """One whose injectors have learnt something."""
    for name, parameter in made.branch.injectors.named_parameters():
        nn.init.normal_(parameter, std=0.2 if name.endswith("weight") else 0.1)
    return made


def tensors(gaussians: Gaussians) -> list[torch.Tensor]:
    return [getattr(gaussians, name) for name in ("means", "rotations", "scales", "opacities", "harmonics")]


@pytest.mark.parametrize("placement", PLACEMENTS)
@torch.no_grad()
def test_at_birth_a_styled_scene_is_the_unstyled_one_bit_for_bit(placement: str) -> None:
    made = stylizer(PLACEMENTS[placement])
    scene = made.encode(VIEWS)
    assert scene.stem.reference is not None and scene.stem.reference.tolist() == [1]
    styled, plain = made.restyle(scene, made.embed(text="red")), made.unstyled(scene)
    for one, other in zip(tensors(styled), tensors(plain), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("placement", PLACEMENTS)
@torch.no_grad()
def test_restyling_an_encoded_scene_is_the_single_pass(placement: str) -> None:
    made = grown(stylizer(PLACEMENTS[placement], init="published"))
    embedding = made.embed(text="red")
    scene = made.encode(VIEWS)
    kept = made.restyle(scene, embedding)

    stem = made.backbone.embedder(VIEWS.images)
    geometry = made.backbone.geometry_head(made.backbone.aggregator(stem), VIEWS.images)

    def inject(site: str, tokens):
        injectors = made.branch.injectors
        return injectors[site](tokens, embedding.vector) if site in injectors else tokens

    features = (made.branch.aggregator or made.backbone.aggregator)(stem, inject)
    styled = made.branch.gaussian_head(features, VIEWS.images, inject).with_degree(1)
    base = made.backbone.gaussian_head(made.backbone.aggregator(stem), VIEWS.images)
    mixed = base.with_(styled, ("rotation", "color"))
    for one, other in zip(tensors(kept), tensors(made.backbone.adapter(mixed, geometry, None)), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("placement", PLACEMENTS)
@torch.no_grad()
def test_a_grown_style_changes_colors_and_leaves_geometry_alone(placement: str) -> None:
    made = grown(stylizer(PLACEMENTS[placement], init="published"))
    scene = made.encode(VIEWS)
    red, blue = (made.restyle(scene, made.embed(text=text)) for text in ("red", "blue"))
    plain = made.unstyled(scene)
    for name in ("means", "scales", "opacities"):
        assert torch.equal(getattr(red, name), getattr(plain, name)), name
    assert not torch.allclose(red.harmonics, plain.harmonics, atol=1e-3)
    assert not torch.allclose(red.harmonics, blue.harmonics, atol=1e-4)


@torch.no_grad()
def test_renders_of_an_untrained_network_show_the_photographs() -> None:
    # Cameras stand together at birth, so every view shows the mean of all; one alone shows itself.
    made = stylizer(Head(), depth_along="z", rotations="camera")
    soft = F.interpolate(VIEWS.images[:, 0, :, ::7, ::7], size=(28, 42), mode="bilinear")
    views = Views(soft[:, None])
    scene = made.encode(views)
    renders = made.render(made.unstyled(scene), scene.cameras)
    inside = (slice(None), slice(None), slice(None), slice(4, -4), slice(4, -4))
    assert (renders.color - views.images)[inside].abs().mean() < 0.03
