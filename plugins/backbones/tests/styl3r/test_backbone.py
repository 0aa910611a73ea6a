"""Intrinsics, the first view, and one view alone."""

import logging

import pytest
import torch

from anystyle.contracts import Backbone
from anystyle.testing.oracle import smooth_image
from anystyle.types import Cameras, Scene, StyleEmbedding, Views
from tests.support.backbone_cases import network

SIZE = (32, 48)


@pytest.fixture(scope="module")
def backbone() -> Backbone:
    return network("styl3r").freeze()


def some_views(count: int, focal: float = 45.0) -> Views:
    lens = torch.tensor([[focal, 0.0, 24.0], [0.0, focal, 16.0], [0.0, 0.0, 1.0]])
    cameras = Cameras(torch.eye(4).expand(1, count, 4, 4), lens.expand(1, count, 3, 3), SIZE)
    return Views(smooth_image(7, (1, count, 3, *SIZE)), cameras=cameras)


@torch.no_grad()
def test_the_first_view_is_the_frame_and_colours_know_none(backbone: Backbone) -> None:
    """Two views exchanged give the same colours in a style, exchanged, and other points."""
    given, order, branch = some_views(3), [1, 0, 2], backbone.make_branch()
    assert branch is not None
    one, other = (backbone.encode(views) for views in (given, given.select(order)))
    tokens = backbone.gaussian_head.style_encoder(smooth_image(9, (1, 1, 3, 32, 32)))
    style = StyleEmbedding(tokens.data.mean((1, 2)), tokens.data.mean((1, 2)), tokens=tokens)
    colors = [branch(scene, style).color for scene in (one, other)]
    torch.testing.assert_close(colors[0][:, order], colors[1], rtol=1e-4, atol=1e-5)
    points = [scene.geometry.points() for scene in (one, other)]
    assert not torch.allclose(points[0][:, order], points[1], rtol=1e-3, atol=1e-3)
    assert not torch.allclose(one.attributes.opacity[:, order], other.attributes.opacity, rtol=1e-3, atol=1e-3)


@torch.no_grad()
def test_intrinsics_are_read_in_units_of_the_image(backbone: Backbone) -> None:
    stems = [backbone.encode(some_views(2, focal=focal)).stem.data for focal in (45.0, 60.0)]
    assert not torch.allclose(*stems, atol=1e-3)
    given = some_views(2)
    assert given.cameras is not None
    small = Views(given.images, cameras=given.cameras.resized((16, 24)))
    torch.testing.assert_close(backbone.encode(small).stem.data, stems[0])


def messages(caplog: pytest.LogCaptureFixture, words: str) -> list[str]:
    return [record.message for record in caplog.records if words in record.message]


@torch.no_grad()
def test_an_assumed_field_of_view_is_that_of_a_camera_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    # 90 degrees along the shorter side of 32 pixels.
    assuming, views = network("styl3r", field_of_view=90.0).freeze(), some_views(2, focal=16.0)
    with caplog.at_level(logging.INFO):
        scenes: list[Scene] = [assuming.encode(Views(views.images)) for _ in range(2)]
    assert len(messages(caplog, "a field of view of 90 degrees along the shorter side")) == 1
    torch.testing.assert_close(scenes[0].stem.data, assuming.encode(views).stem.data)


@torch.no_grad()
def test_one_view_is_told_of_once(caplog: pytest.LogCaptureFixture) -> None:
    alone = network("styl3r").freeze()
    scenes = [alone.encode(some_views(1)) for _ in range(2)]
    assert len(messages(caplog, "there is one view")) == 1
    assert bool(scenes[0].geometry.points().isfinite().all())
