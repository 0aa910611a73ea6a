"""A similarity of cameras against one that is known."""

import pytest
import torch
import torch.nn.functional as F

from anystyle.geometry.transforms import matrix_from_wxyz, similarity_of_cameras


def poses(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    found = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
    turns = torch.randn(count, 4, generator=generator, dtype=torch.float64) * 0.3 + torch.tensor([1.0, 0, 0, 0])
    found[:, :3, :3] = matrix_from_wxyz(F.normalize(turns, dim=-1))
    found[:, :3, 3] = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return found


def test_a_similarity_of_cameras_is_found_and_undone():
    source = poses(4, 0)
    turn, shift = poses(1, 1)[0, :3, :3], torch.tensor([0.3, -2.0, 1.0], dtype=torch.float64)
    target = source.clone()
    target[:, :3, :3] = turn @ source[:, :3, :3]
    target[:, :3, 3] = 2.5 * source[:, :3, 3] @ turn.T + shift
    found = similarity_of_cameras(source, target)
    assert float(found.scale) == pytest.approx(2.5) and torch.allclose(found.poses(source), target, atol=1e-9)
    # Cameras on one spot leave the scale open: it is kept.
    alone = similarity_of_cameras(source[:1], target[:1])
    assert float(alone.scale) == 1.0 and torch.allclose(alone.poses(source[:1]), target[:1], atol=1e-9)
    # Where they move the other way, or not at all, no scale fits them.
    for factor in (-1, 0):
        target[:, :3, 3] *= factor
        assert float(similarity_of_cameras(source, target).scale) == 0
