import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from anystyle_backbones.alignment import MatchedPoints, align, kabsch


def matched(count=200, views=3, outliers=0.0, depth_noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(rng.normal(0, 0.3, (views, 3))).as_matrix()
    translation = rng.normal(0, 0.2, (views, 3))
    target = rng.uniform([-1, -1, 1.5], [1, 1, 4], (views, count, 3))
    source = np.einsum("mji,mpj->mpi", rotation, target - translation[:, None])
    rays = [points[..., :2] / points[..., 2:] for points in (source, target)]
    source = source * np.exp(rng.normal(0, depth_noise, (views, count, 1)))
    target = target * np.exp(rng.normal(0, depth_noise, (views, count, 1)))
    wrong = rng.random((views, count)) < outliers
    target[wrong] = rng.uniform([-1, -1, 1.5], [1, 1, 4], (wrong.sum(), 3))
    rays[1][wrong] = target[wrong][:, :2] / target[wrong][:, 2:]
    tensors = [torch.tensor(array) for array in (source, target, *rays)]
    return MatchedPoints(*tensors, torch.ones(views, count, dtype=torch.float64)), rotation, translation


def test_kabsch_equals_scipy():
    matches, _, _ = matched(depth_noise=0.05)
    weight = torch.rand(3, 200, dtype=torch.float64)
    found = kabsch(matches.source, matches.target, weight)
    for view in range(3):
        w = weight[view].numpy()
        source, target = matches.source[view].numpy(), matches.target[view].numpy()
        centred = [points - (w[:, None] * points).sum(0) / w.sum() for points in (target, source)]
        expected, _ = Rotation.align_vectors(*centred, weights=w)
        np.testing.assert_allclose(found.rotation[view], expected.as_matrix(), atol=1e-8)


def test_exact_matches_give_the_exact_motion():
    matches, rotation, translation = matched()
    found = align(matches, scale=0.02)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-7)
    np.testing.assert_allclose(found.translation, translation, atol=1e-7)


def test_wrong_matches_and_noisy_depth_do_little_harm():
    matches, rotation, _ = matched(outliers=0.3, depth_noise=0.1)
    plain = kabsch(matches.source, matches.target, matches.weight).rotation
    errors = [
        np.degrees(Rotation.from_matrix(np.einsum("mij,mkj->mik", found, rotation)).magnitude())
        for found in (plain.numpy(), align(matches, scale=0.01).rotation.numpy())
    ]
    assert errors[1].max() < 1.0 and errors[1].max() < errors[0].min() / 2


@pytest.mark.parametrize("views", [0, 1])
def test_no_pair_and_no_weight_stay_finite(views):
    matches, _, _ = matched(views=views)
    found = align(matches._replace(weight=torch.zeros_like(matches.weight)), scale=0.02)
    assert found.rotation.shape == (views, 3, 3) and found.rotation.isfinite().all()
