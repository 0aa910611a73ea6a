"""Distillation from Magenta's networks, and retrieval by them."""

from dataclasses import replace

import pytest
import torch

from anystyle.testing.inputs import images
from anystyle.types import Comparison, Style
from anystyle_magenta import MagentaEncoder, MagentaInjector, stylize_images
from anystyle_magenta.retrieval import MagentaRetrieval
from anystyle_magenta.teacher import Teacher
from tests.support.style_cases import stylization

PHOTOGRAPHS = images(4, (48, 64), seed=1).view(2, 2, 3, 48, 64)
STYLES = images(2, (64, 64), seed=5)


@pytest.fixture(scope="module")
def teacher():
    return Teacher(working_size=48)


@pytest.fixture(scope="module")
@torch.no_grad()
def painted():
    """By the encoder and the injector of ``model=painter``."""
    vectors = MagentaEncoder().embed_images(STYLES)
    return stylize_images(MagentaInjector(dim=3, style_dim=100).network, PHOTOGRAPHS, vectors, joint=True)


def test_what_the_painter_paints_is_perfect(teacher, painted):
    assert teacher(stylization(painted, PHOTOGRAPHS, STYLES)) == pytest.approx(0, abs=1e-5)
    assert teacher(stylization(painted.roll(1, 0), PHOTOGRAPHS, STYLES)) > 0.02


def test_the_distance_is_that_of_colours_and_of_edges(teacher, painted):
    """A shift is seen by the first term, and a ramp across by both."""
    ramp = torch.linspace(0, 0.63, 64).expand(painted.shape)
    for added, expected in ((torch.tensor(0.1), 0.1), (ramp, 0.315 + 0.01)):
        assert teacher(stylization(painted + added, PHOTOGRAPHS, STYLES)) == pytest.approx(expected, rel=1e-3)


def test_rows_without_a_style_image_add_nothing(teacher, painted):
    result = stylization(painted + 0.1, PHOTOGRAPHS, STYLES, has_image=torch.tensor([True, False]))
    assert teacher(result) == pytest.approx(0.1, rel=1e-3)
    assert teacher(replace(result, style=Style(text=("a", "b")))) == 0


def test_nothing_of_it_learns_or_is_kept(teacher):
    assert not teacher.state_dict() and not any(part.requires_grad for part in teacher.parameters())
    renders = PHOTOGRAPHS.clone().requires_grad_()
    teacher(stylization(renders, PHOTOGRAPHS, STYLES)).backward()
    assert renders.grad is not None and renders.grad.abs().max() > 0


@pytest.mark.slow
def test_scenes_that_show_their_style_are_found_and_others_not():
    sheets = images(4, (96, 96), seed=3) * torch.linspace(0.3, 1, 4).view(4, 1, 1, 1)
    for shift, expected in ((0, 1.0), (1, 0.0)):
        metric = MagentaRetrieval()
        views = sheets.roll(shift, 0)[:, None].expand(-1, 2, -1, -1, -1)
        metric.update(Comparison(content=views, stylized=views, style=Style(image=sheets), scenes=("one",) * 4))
        with pytest.warns(UserWarning, match="does not tell . of 4 styles"):  # halves of noise are unlike
            scores = metric.scores()
        assert scores["magenta_retrieval"] == scores["magenta_retrieval_gray"] == expected
    assert list(metric.weights) == ["arbitrary_predict.onnx"]
