"""Rotations against scipy."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from anystyle.geometry.transforms import (
    matrix_from_vector,
    matrix_from_wxyz,
    multiply,
    nearest_rotation,
    wxyz_from_matrix,
    wxyz_from_xyzw,
)


def rotations(count: int, seed: int = 0) -> Rotation:
    return Rotation.random(count, random_state=np.random.default_rng(seed))


def wxyz(rotation: Rotation) -> torch.Tensor:
    return wxyz_from_xyzw(torch.from_numpy(rotation.as_quat()))


def test_matrices() -> None:
    expected = torch.from_numpy(rotations(50).as_matrix())
    torch.testing.assert_close(matrix_from_wxyz(3.7 * wxyz(rotations(50))), expected)


def test_the_zero_quaternion_is_the_identity() -> None:
    quaternion = torch.zeros(4, requires_grad=True)
    matrix = matrix_from_wxyz(quaternion)
    assert torch.equal(matrix, torch.eye(3))
    matrix.sum().backward()
    assert quaternion.grad is not None and quaternion.grad.isfinite().all()


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


def test_matrices_of_rotation_vectors() -> None:
    vectors = np.concatenate([rotations(30).as_rotvec(), np.zeros((1, 3)), [[1e-9, 0, 0]]])
    expected = torch.from_numpy(Rotation.from_rotvec(vectors).as_matrix())
    torch.testing.assert_close(matrix_from_vector(torch.from_numpy(vectors)), expected)


def test_the_nearest_rotation_is_the_one_of_scipy() -> None:
    """Of noisy correspondences, reflections among them, for which the nearest orthogonal matrix is no rotation."""
    random = np.random.default_rng(3)
    for _ in range(20):
        source, target = random.normal(size=(2, 4, 3))
        expected, _ = Rotation.align_vectors(target, source)
        result = nearest_rotation(torch.from_numpy(target.T @ source))
        torch.testing.assert_close(result, torch.from_numpy(expected.as_matrix()), rtol=0, atol=1e-9)
