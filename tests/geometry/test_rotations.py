"""Rotations against scipy."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from anystyle.geometry.rotations import (
    matrix_from_wxyz,
    multiply,
    slerp,
    wxyz_from_matrix,
    wxyz_from_xyzw,
    xyzw_from_wxyz,
)


def rotations(count: int, seed: int = 0) -> Rotation:
    return Rotation.random(count, random_state=np.random.default_rng(seed))


def wxyz(rotation: Rotation) -> torch.Tensor:
    return wxyz_from_xyzw(torch.from_numpy(rotation.as_quat()))


def test_matrices() -> None:
    expected = torch.from_numpy(rotations(50).as_matrix())
    torch.testing.assert_close(matrix_from_wxyz(3.7 * wxyz(rotations(50))), expected)


def test_orders_of_components() -> None:
    quaternion = torch.tensor([1.0, 2.0, 3.0, 4.0])
    assert xyzw_from_wxyz(quaternion).tolist() == [2.0, 3.0, 4.0, 1.0]
    assert wxyz_from_xyzw(xyzw_from_wxyz(quaternion)).tolist() == quaternion.tolist()


def test_the_zero_quaternion_is_the_identity() -> None:
    quaternion = torch.zeros(4, requires_grad=True)
    matrix = matrix_from_wxyz(quaternion)
    assert torch.equal(matrix, torch.eye(3))
    matrix.sum().backward()
    assert quaternion.grad is not None
    assert quaternion.grad.isfinite().all()


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-4, 1.0, np.pi - 1e-8, np.pi])
def test_quaternions_of_matrices(angle: float) -> None:
    """About the axes, their diagonals and random directions, half turns included."""
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [0, -1, 1], [1, 0, 1]], rotations(20).as_rotvec()])
    rotation = Rotation.from_rotvec(angle * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    quaternions = wxyz_from_matrix(torch.from_numpy(rotation.as_matrix()))
    assert (quaternions[:, 0] >= 0).all()
    torch.testing.assert_close(quaternions.norm(dim=-1), torch.ones(len(axes), dtype=torch.float64))
    expected = wxyz(rotation)
    sign = (quaternions * expected).sum(-1, keepdim=True).sign()
    torch.testing.assert_close(sign * quaternions, expected, rtol=0, atol=1e-12)


def test_products() -> None:
    left, right = rotations(30, 1), rotations(30, 2)
    product = matrix_from_wxyz(multiply(wxyz(left), wxyz(right)))
    torch.testing.assert_close(product, torch.from_numpy((left * right).as_matrix()))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_slerp(share: float) -> None:
    start, end = rotations(30, 1), rotations(30, 2)
    ways = [Slerp([0, 1], Rotation.concatenate([a, b]))(share) for a, b in zip(start, end, strict=True)]
    expected = torch.from_numpy(Rotation.concatenate(ways).as_matrix())
    for sign in (1, -1):
        torch.testing.assert_close(matrix_from_wxyz(slerp(2 * wxyz(start), sign * wxyz(end), share)), expected)
    amounts = torch.full((30,), share, dtype=torch.float64)
    torch.testing.assert_close(matrix_from_wxyz(slerp(wxyz(start), wxyz(end), amounts)), expected)


def test_slerp_between_equals_has_a_gradient() -> None:
    start = torch.tensor([1.0, 0.2, -0.3, 0.5], requires_grad=True)
    between = slerp(start, start.detach(), 0.5)
    torch.testing.assert_close(between, start.detach() / start.detach().norm())
    between.sum().backward()
    assert start.grad is not None
    assert start.grad.isfinite().all()
