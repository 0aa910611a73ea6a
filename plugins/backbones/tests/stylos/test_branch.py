"""The style branch: what it leaves alone, and mistakes that a reimplementation makes easily."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle.commands import stylize
from anystyle.errors import UserError
from anystyle.io.sheet import to_pil
from anystyle.nn.tokens import normalised
from anystyle.pipeline.options import BranchOptions
from anystyle.stylizer import Stylizer
from anystyle.testing.oracle import smooth_image
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import Gaussians, Scene, StyleEmbedding, Tokens
from anystyle_backbones.stylos import Stylos, StylosStyle
from anystyle_backbones.stylos.heads import GaussianHead, StylosBranch
from anystyle_backbones.stylos.transformer import STEM
from tests.support.backbone_cases import network, same, views


@pytest.fixture(scope="module")
def stylizer() -> Stylizer:
    backbone = network("stylos")
    encoder = StylosStyle(**(StylosStyle.example(Path()) | {"native_resolution": 56, "resolution": None}))
    encoder.patches.load_state_dict(backbone.embedder.patches.state_dict())
    branch = backbone.make_branch()
    assert branch is not None
    return Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer()).eval()


@pytest.fixture(scope="module")
def scene(stylizer: Stylizer) -> Scene:
    return stylizer.encode(views(3))


def embedding(tokens: Tokens) -> StyleEmbedding:
    vector = tokens.data.mean((1, 2))
    return StyleEmbedding(vector, vector, tokens=tokens)


def first_view(scene: Scene) -> StyleEmbedding:
    return embedding(replace(scene.stem, data=scene.stem.patches[:, :1], special=0))


@torch.no_grad()
def test_the_first_view_as_style_is_no_style_to_the_bit(stylizer: Stylizer, scene: Scene) -> None:
    assert torch.equal(stylizer.branch(scene, first_view(scene)).color, scene.attributes.color)
    styled, unstyled = stylizer.restyle(scene, first_view(scene)), stylizer.unstyled(scene)
    for name, tensor in vars(unstyled).items():
        assert torch.equal(getattr(styled, name), tensor), name
    picture = stylizer.restyle(scene, stylizer.embed(image=scene.views.images[:, 0]))
    torch.testing.assert_close(picture.harmonics, unstyled.harmonics)


@torch.no_grad()
def test_geometry_does_not_depend_on_style(stylizer: Stylizer, scene: Scene) -> None:
    one, other = (stylizer.restyle(scene, stylizer.embed(image=smooth_image(n, (1, 3, 28, 42)))) for n in (7, 9))
    for name, tensor in vars(one).items():
        assert torch.equal(getattr(other, name), tensor) == (name != "harmonics"), name
    assert isinstance(one, Gaussians)


@torch.no_grad()
def test_a_style_has_a_grid_of_its_own(stylizer: Stylizer, scene: Scene) -> None:
    tall = stylizer.embed(image=smooth_image(7, (1, 3, 56, 14)))
    assert tall.tokens is not None and tall.tokens.grid == (4, 1) != scene.stem.grid
    turned = embedding(replace(tall.tokens, grid=(1, 4)))
    assert not torch.equal(stylizer.branch(scene, tall).color, stylizer.branch(scene, turned).color)
    two = stylizer.embed(image=smooth_image(7, (2, 3, 28, 28)))
    together = stylizer.restyle(scene, two)
    for row in range(2):
        same(together.row(row), stylizer.restyle(scene, two.row(row)))


def test_a_branch_holds_copies_alone(stylizer: Stylizer) -> None:
    head, branch = stylizer.backbone.gaussian_head, stylizer.branch
    assert isinstance(head, GaussianHead) and isinstance(branch, StylosBranch)
    assert [name for name, _ in branch.named_children()] == ["aggregator", "gaussian_head", "injectors"]
    assert all(parameter.requires_grad for parameter in branch.parameters()) and not len(branch.injectors)
    assert not {id(each) for each in branch.parameters()} & {id(each) for each in head.parameters()}


def test_texts_are_refused(stylizer: Stylizer, scene: Scene) -> None:
    with pytest.raises(UserError, match="'red': Stylos reads style images"):
        stylizer.embed(text="red")
    vector = torch.zeros(1, 32)
    with pytest.raises(UserError, match="reads the tokens of a style image"):
        stylizer.branch(scene, StyleEmbedding(vector, vector))


def embedded(encoder: StylosStyle, images: Tensor) -> Tensor:
    return encoder.patches(normalised(images))[:, None]


def test_the_style_encoder_crops_as_published() -> None:
    encoder = StylosStyle(**(StylosStyle.example(Path()) | {"resolution": 28}))
    wide = smooth_image(3, (1, 3, 56, 84))
    assert encoder.embed_tokens(wide).grid == (2, 2)
    small = torch.nn.functional.interpolate(wide, (28, 42), mode="bicubic", antialias=True)
    cut = small[..., 7:35].clamp(0, 1).contiguous()
    torch.testing.assert_close(encoder.embed_tokens(wide).data, encoder.embed_tokens(cut).data)
    exact = smooth_image(3, (1, 3, 28, 28))
    assert torch.equal(encoder.embed_tokens(exact).data, embedded(encoder, exact))
    assert not encoder.unit_norm and not encoder.reads_texts and encoder.token_dim == encoder.dim


def test_the_stem_is_among_the_features_and_is_not_copied(scene: Scene) -> None:
    assert scene.features[STEM].data is scene.stem.data and min(scene.features) == STEM


def test_photographs_and_a_painting_to_a_scene(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The command, from files to files, with networks that no weights are named for: it says so."""
    (tmp_path / "photos").mkdir()
    for number in range(2):
        to_pil(smooth_image(number, (3, 56, 84))).save(tmp_path / "photos" / f"{number}.png")
    to_pil(smooth_image(7, (3, 70, 84))).save(tmp_path / "a.png")
    options = {f"backbone.{name}": value for name, value in Stylos.example(tmp_path).items()}
    options |= {f"style_encoder.{name}": value for name, value in StylosStyle.example(tmp_path).items()}
    network = [f"{name}={list(value) if isinstance(value, tuple) else value}" for name, value in options.items()]
    small = ["poses=predicted", "views.short_side=56", "video.frames=2", "video.scale=0.5"]
    words = [tmp_path / "photos", "--image", tmp_path / "a.png", "--out", tmp_path / "out", "model=stylos"]
    stylize.main([*map(str, words), "weights.backbone=null", *network, *small])
    assert (tmp_path / "out" / "scene.ply").is_file() and "the backbone is untrained" in caplog.text


def test_options_that_the_published_branch_fixes_are_refused() -> None:
    with pytest.raises(UserError, match="set no other option of branch with it"):
        BranchOptions(published=True, styled=["rotation"])
