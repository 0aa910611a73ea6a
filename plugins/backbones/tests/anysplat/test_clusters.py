"""Fusion of points by voxels, against loops."""

import pytest
import torch
from torch import Tensor

from anystyle.testing.oracle import hashed
from anystyle_backbones.anysplat.adapter import fuse, lexicographic_ranks, voxel_clusters


def points(index: int, scenes: int, count: int, half: float = 1.0) -> Tensor:
    return hashed(index, (scenes, count, 3), -half, half)


def test_each_voxel_is_a_softmax_of_its_points() -> None:
    places, logits, values = points(1, 1, 200), hashed(2, (1, 200), -3, 3), hashed(3, (1, 200, 4))
    clusters = voxel_clusters(places, logits, 0.5)
    fused = fuse(values, clusters)
    cells = (places[0] / 0.5).round().int().tolist()
    for rank, cell in enumerate(sorted(set(map(tuple, cells)))):
        inside = torch.tensor([tuple(other) == cell for other in cells])
        assert (clusters.index[0] == rank).tolist() == inside.tolist()
        share = logits[0, inside].double().softmax(0)
        torch.testing.assert_close(clusters.weight[0, inside].double(), share, rtol=2e-6, atol=0)
        torch.testing.assert_close(
            clusters.means[0, rank].double(), share @ places[0, inside].double(), rtol=1e-5, atol=1e-6
        )
        torch.testing.assert_close(fused[0, rank].double(), share @ values[0, inside].double(), rtol=1e-5, atol=1e-6)


def test_gradients_reach_points_confidences_and_values() -> None:
    inputs = (points(10, 1, 12), hashed(11, (1, 12), -1, 1), hashed(12, (1, 12, 2)))

    def fused(places: Tensor, logits: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        clusters = voxel_clusters(places, logits, 1.0)
        return clusters.means, fuse(values, clusters)

    assert torch.autograd.gradcheck(fused, tuple(tensor.double().requires_grad_() for tensor in inputs))


@pytest.mark.parametrize("span", [3, 2**20, 2**40])
def test_ranks_equal_those_of_unique_rows(span: int) -> None:
    cells = torch.randint(-span, span, (300, 3), generator=torch.Generator().manual_seed(span))
    cells = torch.cat([cells, cells[::3]])
    assert torch.equal(lexicographic_ranks(cells), torch.unique(cells, dim=0, return_inverse=True)[1])


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_points_that_are_no_numbers_are_refused(bad: float) -> None:
    places = torch.zeros(1, 2, 3)
    places[0, 1, 2] = bad
    with pytest.raises(ValueError, match="have diverged"):
        voxel_clusters(places, torch.zeros(1, 2), 0.1)


def test_scenes_of_a_batch_do_not_mix_and_are_padded() -> None:
    many, few = points(4, 1, 64), points(5, 1, 64, half=0.2)
    logits, values = hashed(6, (2, 64), -1, 1), hashed(7, (2, 64, 2))
    both = voxel_clusters(torch.cat([many, few]), logits, 0.3)
    fused = fuse(values, both)
    assert both.valid.sum(1)[0] > both.valid.sum(1)[1]
    for scene, places in enumerate((many, few)):
        alone = voxel_clusters(places, logits[scene : scene + 1], 0.3)
        count = alone.means.shape[1]
        assert both.valid[scene].tolist() == [place < count for place in range(both.valid.shape[1])]
        assert torch.equal(both.means[scene, :count], alone.means[0])
        assert torch.equal(fused[scene, :count], fuse(values[scene : scene + 1], alone)[0])
        assert not fused[scene, count:].any() and not both.means[scene, count:].any()
