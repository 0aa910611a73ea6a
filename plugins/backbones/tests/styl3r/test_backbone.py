"""What holds for the network whatever its weights."""

import logging
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from anystyle.contracts import Backbone, StylePredictor, style_tokens
from anystyle.errors import UserError
from anystyle.testing.oracle import smooth_image
from anystyle.types import Attributes, Cameras, Scene, StyleEmbedding, Tokens, Views
from anystyle_backbones.styl3r import Styl3r, Styl3rStyle
from anystyle_backbones.styl3r.heads import GaussianHead
from anystyle_backbones.styl3r.transformer import symmetric
from tests.support.backbone_cases import network

EXAMPLE = Styl3r.example(Path())
SIZE = (32, 48)


@pytest.fixture(scope="module")
def backbone() -> Backbone:
    return network("styl3r").freeze()


def some_views(count: int, scenes: int = 1, focal: float = 45.0) -> Views:
    lens = torch.tensor([[focal, 0.0, 24.0], [0.0, focal, 16.0], [0.0, 0.0, 1.0]])
    cameras = Cameras(torch.eye(4).expand(scenes, count, 4, 4), lens.expand(scenes, count, 3, 3), SIZE)
    return Views(smooth_image(7, (scenes, count, 3, *SIZE)), cameras=cameras)


def branch_of(backbone: Backbone) -> StylePredictor:
    branch = backbone.make_branch()
    assert branch is not None
    return branch


def embedding_of(backbone: Backbone, pictures: Tensor) -> StyleEmbedding:
    """A style by the stylizer's own encoder, pixels as they are."""
    assert isinstance(backbone.gaussian_head, GaussianHead)
    tokens = backbone.gaussian_head.style_encoder(pictures[:, None])
    return StyleEmbedding(tokens.data.mean((1, 2)), tokens.data.mean((1, 2)), tokens=tokens)


@torch.no_grad()
@pytest.mark.parametrize("views", [1, 2, 3])
def test_the_branch_with_the_first_view_as_style_is_the_unstyled_scene(backbone: Backbone, views: int) -> None:
    scene, branch = backbone.encode(some_views(views, scenes=2)), branch_of(backbone)
    attributes = branch(scene, embedding_of(backbone, symmetric(scene.views.images[:, 0])))
    assert torch.equal(attributes.color, scene.attributes.color)
    # Trap 1: the released inference feeds styles in [0, 1], which is another style.
    other = branch(scene, embedding_of(backbone, scene.views.images[:, 0]))
    assert not torch.allclose(other.color, attributes.color, rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_style_touches_colours_alone(backbone: Backbone) -> None:
    scene, branch = backbone.encode(some_views(2)), branch_of(backbone)
    unstyled = backbone.adapter(scene.attributes, scene.geometry, None)
    for size in ((16, 16), (64, 32)):
        styled = branch(scene, embedding_of(backbone, smooth_image(9, (1, 3, *size))))
        attributes = scene.attributes.with_(styled, branch.styled)
        gaussians = backbone.adapter(attributes, scene.geometry, None)
        for name in ("means", "rotations", "scales", "opacities"):
            assert torch.equal(getattr(gaussians, name), getattr(unstyled, name)), name
        assert not torch.equal(gaussians.harmonics, unstyled.harmonics)


def test_the_branch_holds_what_a_style_costs_and_no_more(backbone: Backbone) -> None:
    branch = branch_of(backbone)
    parts = {name.partition(".")[0] for name, _ in branch.named_parameters()}
    assert parts == {"aggregator", "gaussian_head"} and branch.styled == ("color",)
    assert all(parameter.requires_grad for parameter in branch.parameters())
    assert not any("direct" in name for name, _ in branch.named_parameters())
    assert isinstance(backbone.gaussian_head, GaussianHead)
    kept = (backbone.gaussian_head.stylizer, backbone.gaussian_head.color)
    assert sum(map(Tensor.numel, branch.parameters())) == sum(p.numel() for part in kept for p in part.parameters())
    assert not {id(p) for p in branch.parameters()} & {id(p) for p in backbone.parameters()}


def test_a_text_has_no_tokens(backbone: Backbone) -> None:
    with torch.no_grad():
        scene = backbone.encode(some_views(2))
    with pytest.raises(UserError, match="reads the tokens of a style image"):
        branch_of(backbone)(scene, StyleEmbedding(torch.zeros(1, 32), torch.zeros(1, 32)))


def parts_of(scene: Scene) -> dict[str, Tensor]:
    attributes: Attributes = scene.attributes
    return {"points": scene.geometry.points(), **{name: getattr(attributes, name) for name in ("opacity", "color")}}


@torch.no_grad()
def test_views_behind_the_first_may_be_given_in_any_order(backbone: Backbone) -> None:
    given, order = some_views(4), [0, 3, 1, 2]
    one, other = (parts_of(backbone.encode(views)) for views in (given, given.select(order)))
    for name, values in one.items():
        torch.testing.assert_close(values[:, order], other[name], rtol=1e-4, atol=1e-5, msg=name)


@torch.no_grad()
def test_the_first_view_is_the_frame_and_colours_know_none(backbone: Backbone) -> None:
    """Two views exchanged give the same colours in a style, exchanged, and other points."""
    given, order, branch = some_views(3), [1, 0, 2], branch_of(backbone)
    one, other = (backbone.encode(views) for views in (given, given.select(order)))
    style = embedding_of(backbone, smooth_image(9, (1, 3, 32, 32)))
    colors = [branch(scene, style).color for scene in (one, other)]
    torch.testing.assert_close(colors[0][:, order], colors[1], rtol=1e-4, atol=1e-5)
    for name in ("points", "opacity"):
        assert not torch.allclose(parts_of(one)[name][:, order], parts_of(other)[name], rtol=1e-3, atol=1e-3), name


@torch.no_grad()
def test_intrinsics_are_read_in_units_of_the_image(backbone: Backbone) -> None:
    stems = [backbone.encode(some_views(2, focal=focal)).stem.data for focal in (45.0, 45.0, 60.0)]
    assert torch.equal(stems[0], stems[1]) and not torch.allclose(stems[0], stems[2], atol=1e-3)
    given = some_views(2)
    assert given.cameras is not None
    small = Views(given.images, cameras=given.cameras.resized((16, 24)))
    torch.testing.assert_close(backbone.encode(small).stem.data, stems[0])


@torch.no_grad()
def test_an_assumed_field_of_view_is_that_of_a_camera_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    # 90 degrees along the shorter side of 32 pixels.
    assuming, views = network("styl3r", field_of_view=90.0).freeze(), some_views(2, focal=16.0)
    with caplog.at_level(logging.INFO):
        for _ in range(2):
            scene = assuming.encode(Views(views.images))
    assert [record.message for record in caplog.records if "90 degrees along the shorter side" in record.message]
    assert len([record for record in caplog.records if "intrinsics" in record.message]) == 1
    torch.testing.assert_close(scene.stem.data, assuming.encode(views).stem.data)


@torch.no_grad()
def test_one_view_is_told_of(caplog: pytest.LogCaptureFixture) -> None:
    alone = network("styl3r").freeze()
    for _ in range(2):
        scene = alone.encode(some_views(1))
    assert [record.message for record in caplog.records if "there is one view" in record.message]
    assert len(caplog.records) == 1
    assert all(bool(values.isfinite().all()) for values in parts_of(scene).values())


@torch.no_grad()
def test_the_number_of_views_at_a_time_changes_memory_only() -> None:
    one, all_ = (network("styl3r", chunk=chunk).freeze().encode(some_views(4)) for chunk in (1, 8))
    for name, values in parts_of(one).items():
        torch.testing.assert_close(values, parts_of(all_)[name], rtol=1e-5, atol=1e-6, msg=name)


@torch.no_grad()
@pytest.mark.parametrize("precision", [torch.bfloat16])
def test_parts_in_bf16_are_near(precision: torch.dtype) -> None:
    exact, near = network("styl3r").freeze(), network("styl3r").freeze()
    for part in (near.embedder, near.aggregator, near.gaussian_head):
        part.to(precision)
    branch = branch_of(near)
    one, other = exact.encode(some_views(2)), near.encode(some_views(2))
    torch.testing.assert_close(one.geometry.points(), other.geometry.points(), rtol=0.1, atol=0.1)
    style = embedding_of(exact, smooth_image(9, (1, 3, 32, 32)))
    color = branch(other, style).color.float()
    torch.testing.assert_close(branch_of(exact)(one, style).color, color, rtol=0.1, atol=0.1)
    assert style_tokens(style).data.dtype == torch.float32


@pytest.mark.parametrize(
    ("options", "message"),
    [({"heads": 3}, "heads is 3, of 32 channels"), ({"decoder_heads": 5}, "decoder_heads is 5, of 24 channels")],
)
def test_options_that_contradict_each_other(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Styl3r(**(EXAMPLE | options))


class TestStyleEncoder:
    encoder = Styl3rStyle(**Styl3rStyle.example(Path())).eval()

    @torch.no_grad()
    def test_tokens_are_those_of_the_middle_square(self) -> None:
        tokens = self.encoder.embed_tokens(smooth_image(3, (2, 3, 50, 80)))
        assert tokens.grid == (2, 2) and list(tokens.data.shape) == [2, 1, 4, 32] and tokens.special == 0
        square = smooth_image(3, (2, 3, 32, 32))
        plain = self.encoder.encoder(square[:, None])
        assert torch.equal(self.encoder.embed_tokens(square).data, plain.data)
        torch.testing.assert_close(self.encoder.embed_images(square), plain.data.mean((1, 2)))

    @torch.no_grad()
    def test_the_range_of_pixels_is_an_option(self) -> None:
        other = Styl3rStyle(**Styl3rStyle.example(Path()), style_range="symmetric").eval()
        other.load_state_dict(self.encoder.state_dict())
        square = smooth_image(3, (1, 3, 32, 32))
        assert torch.equal(other.embed_tokens(square).data, self.encoder.embed_tokens(symmetric(square)).data)

    def test_texts_are_refused_in_one_line(self) -> None:
        with pytest.raises(UserError, match="'red': Styl3R reads style images, no texts"):
            self.encoder.embed_texts([self.encoder.neutral, "red"])

    @torch.no_grad()
    def test_one_pass_gives_the_vector_and_the_tokens(self) -> None:
        encoder, square = Styl3rStyle(**Styl3rStyle.example(Path())).eval(), smooth_image(3, (1, 3, 32, 32))
        passes: list[object] = []
        encoder.encoder.register_forward_hook(lambda *given: passes.append(given))
        vector, tokens = encoder.embed_both(square)
        assert len(passes) == 1
        assert torch.equal(vector, encoder.embed_images(square))
        assert torch.equal(tokens.data, encoder.embed_tokens(square).data)

    def test_a_style_of_any_grid_is_one_view(self) -> None:
        assert isinstance(self.encoder.embed_tokens(torch.zeros(1, 3, 32, 32)), Tokens)
