"""The view that the others are seen from: which one it is, and that it does not depend on the order."""

import pytest
import torch
import torch.nn.functional as F
from scipy.spatial.distance import cdist

from anystyle.testing.oracle import hashed
from anystyle_backbones.reference_view import in_order, reference_first, reference_view

IMAGES = hashed(2, (2, 5, 3, 16, 24))
TOKENS = hashed(9, (2, 5, 16), -1, 1)
ORDER = [3, 0, 4, 1, 2]


@pytest.mark.parametrize("strategy", ["saddle_balanced", "saddle_sim_range", "middle", "first"])
def test_published_strategies_keep_the_first_of_two_views(strategy):
    assert reference_view(IMAGES[:, :2], TOKENS[:, :2], strategy) is None


@pytest.mark.parametrize(("strategy", "views"), [("saddle_balanced", 5), ("central", 5), ("central", 2)])
def test_the_choice_follows_the_view_and_not_its_place(strategy, views):
    order = ORDER if views == 5 else [1, 0]
    images, tokens = IMAGES[:, :views], TOKENS[:, :views]
    first = reference_view(images, tokens, strategy)
    moved = reference_view(images[:, order], tokens[:, order], strategy)
    assert [order[place] for place in moved.tolist()] == first.tolist() and moved.tolist() != first.tolist()


def test_the_balanced_one_is_in_the_middle_of_every_range():
    # Three directions in a plane, of growing norm: the middle one is nearest to half of what is not the same.
    angle = torch.tensor([0.0, 0.4, 0.9])
    tokens = torch.stack([angle.cos(), angle.sin(), torch.zeros(3)], dim=-1) * torch.tensor([[1.0], [1.5], [2.0]])
    unit = F.normalize(tokens, dim=-1)
    figures = [((unit @ unit.mT).sum(-1) - 1) / 2, tokens.norm(dim=-1), unit.var(dim=-1)]
    scores = sum(((f - f.min()) / (f.max() - f.min() + 1e-8) - 0.5).abs() for f in figures)
    expected = int(torch.as_tensor(scores).argmin())
    assert reference_view(IMAGES[:1, :3], tokens[None], "saddle_balanced").tolist() == [expected]


def test_the_central_one_is_nearest_to_all_others():
    """The medoid by scipy, of photographs as small as thumbnails."""
    images = IMAGES.unfold(3, 2, 2).unfold(4, 3, 3).mean((-2, -1))  # 8 x 8 pixels
    expected = [int(cdist(rows, rows).sum(0).argmin()) for rows in images.flatten(2).numpy()]
    assert reference_view(IMAGES, TOKENS, "central").tolist() == expected
    # A camera that moves along a line sees most of what the others see from its middle.
    line = torch.arange(5.0).view(1, 5, 1, 1, 1).expand(1, 5, 3, 8, 8) / 5
    assert reference_view(line[:, [4, 0, 2, 1, 3]], TOKENS[:1], "central").tolist() == [2]


def test_the_others_stay_in_order_and_can_be_put_back():
    order = reference_first(torch.tensor([2, 0]), 4)
    assert order.tolist() == [[2, 0, 1, 3], [0, 1, 2, 3]]
    data = hashed(1, (2, 4, 3, 2))
    assert torch.equal(in_order(in_order(data, order), order.argsort(dim=1)), data)
