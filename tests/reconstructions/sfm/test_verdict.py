"""Wrong models are told from right ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anystyle.reconstructions.sfm.matches import Features, VerifiedPair, pairs_to_match
from anystyle.reconstructions.sfm.model import Lens, SparseModel, Tracks, triangulation_angles
from anystyle.reconstructions.sfm.support import agreement, share_of_rotation, supported_views
from anystyle.reconstructions.sfm.verdict import Capture, judge
from reconstructions.sfm.cards import arc

VIEWS, SIZE = 6, (480, 640)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def model_of(poses, points, seen):
    """The exact model in which each view sees these of the points; its pixels are not used here."""
    point, view = np.nonzero(seen)
    lens = Lens((500.0, 500.0), (320.0, 240.0), 0.0, SIZE)
    tracks = Tracks(point, view, np.zeros((len(point), 2)))
    return SparseModel(poses, (lens,) * len(poses), points, tracks)


@pytest.fixture
def right(rng):
    return model_of(arc(VIEWS, 50), rng.uniform(-1, 1, (300, 3)), rng.random((300, VIEWS)) < 0.7)


@pytest.fixture
def capture(rng):
    pairs = [VerifiedPair(0, view, rng.uniform(0, 480, (2, 40, 2))) for view in range(1, VIEWS)]
    return Capture([f"view{view}" for view in range(VIEWS)], [500] * VIEWS, [SIZE] * VIEWS, pairs)


def moved(model, rng):
    """The same model in another frame and unit."""
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    pose = model.world_from_camera.copy()
    pose[:, :3, :3] = turn @ pose[:, :3, :3]
    pose[:, :3, 3] = 3.7 * pose[:, :3, 3] @ turn.T + shift
    return replace(model, world_from_camera=pose, points=3.7 * model.points @ turn.T + shift)


def displaced(model, view, shift=(0.0, 0.0, 0.8)):
    pose = model.world_from_camera.copy()
    pose[view, :3, 3] += shift
    return replace(model, world_from_camera=pose)


def test_agreement_ignores_the_frame_and_finds_the_odd_view(right, rng):
    same = agreement(moved(right, rng).world_from_camera, right.world_from_camera)
    assert same.rotation.max() < 1e-4 and same.position.max() < 1e-9
    odd = agreement(moved(displaced(right, 4), rng).world_from_camera, right.world_from_camera)
    assert np.flatnonzero(~odd.within(2.0, 0.1)).tolist() == [4]
    spread = np.sqrt(
        np.square(right.world_from_camera[:, :3, 3] - right.world_from_camera[:, :3, 3].mean(0)).sum(1).mean()
    )
    assert odd.position[4] == pytest.approx(0.8 / spread, rel=1e-6)


def test_a_view_hangs_on_points_of_three():
    """Points that two views see say nothing of how far apart they are."""
    seen = np.zeros((200, 5), dtype=bool)
    seen[:100, :3] = True  # three views that see the same
    seen[100:140, 2:4] = True  # a view that shares with one of them alone
    assert supported_views(seen, 30).tolist() == [0, 1, 2]
    seen[100:135, 1] = True  # and now with two
    assert supported_views(seen, 30).tolist() == [0, 1, 2, 3]
    assert supported_views(seen, 36).tolist() == [0, 1, 2]
    assert supported_views(seen, 136).tolist() == []


def test_two_halves_joined_at_one_view_are_two():
    """Their relative size is open."""
    seen = np.zeros((300, 7), dtype=bool)
    seen[:100, :4] = True
    seen[100:280, 3:] = True
    assert supported_views(seen, 30).tolist() == [3, 4, 5, 6]


def test_models_that_agree_are_good(capture, right, rng):
    judged = judge(capture, [[right], [moved(right, rng)]])
    assert judged.verdict.trust == "good" and judged.verdict.reasons == ()
    assert judged.model is not None and judged.model.registered.all()


def test_a_model_that_nothing_confirms_is_doubtful(capture, right):
    judged = judge(capture, [[right], []])
    assert judged.verdict.trust == "doubtful" and "only one of two methods" in judged.verdict.reasons[0]


def test_a_view_in_dispute_is_named_and_left_out(capture, right, rng):
    judged = judge(capture, [[displaced(right, 4)], [moved(right, rng)]])
    assert judged.verdict.trust == "doubtful"
    assert "disagree on the cameras of view4 " in judged.verdict.reasons[0]
    assert judged.model is not None and np.flatnonzero(~judged.model.registered).tolist() == [4]


def test_two_different_shapes_are_doubtful(capture, right, rng):
    other = right
    for view in range(VIEWS):
        other = displaced(other, view, tuple(rng.normal(size=3)))
    judged = judge(capture, [[right], [other]])
    assert judged.verdict.trust == "doubtful" and judged.model is not None
    assert judged.model.registered.all() and "disagree" in judged.verdict.reasons[0]


def test_a_view_held_by_few_is_left_out(capture, right, rng):
    seen = right.seen()
    seen[:, 5] = False
    seen[:10, 5] = True
    weak = model_of(right.world_from_camera, right.points, seen)
    judged = judge(capture, [[displaced(weak, 5)], [moved(weak, rng)]])
    assert judged.verdict.trust == "good"
    assert judged.verdict.reasons[0].startswith("view5 shares too little")


def test_the_larger_model_is_taken(capture, right, rng):
    seen = right.seen()
    seen[:, 5] = False
    fewer = model_of(right.world_from_camera, right.points, seen).restricted(np.arange(5))
    judged = judge(capture, [[fewer], [moved(right, rng)]])
    assert judged.model is not None and judged.model.registered.all()


def test_rays_that_hardly_differ_are_doubtful(capture, right, rng):
    far = model_of(right.world_from_camera, right.points * 0.1 + [0, 0, 400.0], right.seen())
    judged = judge(capture, [[far], [moved(far, rng)]])
    assert judged.verdict.trust == "doubtful" and "depth is uncertain" in judged.verdict.reasons[0]


def test_angles_of_rays():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [-1, 0, 1]
    model = model_of(poses, np.array([[0.0, 0, 1], [0, 0, 1]]), np.array([[True, True, True], [True, True, False]]))
    np.testing.assert_allclose(triangulation_angles(model), [90, 45])


def test_restricting_keeps_points_of_two_views(right):
    part = right.restricted(np.array([0, 2, 3]))
    both = right.seen()[:, [0, 2, 3]].sum(1) >= 2
    np.testing.assert_array_equal(part.points, right.points[both])
    np.testing.assert_array_equal(part.seen()[:, [0, 2, 3]], right.seen()[both][:, [0, 2, 3]])
    assert not part.seen()[:, [1, 4, 5]].any() and part.num_registered == 3


def test_turns_are_told_from_steps(rng):
    """Bearings of points at several depths, with half a pixel of noise."""
    points = np.concatenate([rng.uniform(-1, 1, (300, 2)), rng.uniform(2, 6, (300, 1))], 1)

    def pixels(shift, turn):
        local = (points - shift) @ Rotation.from_rotvec([0, turn, 0]).as_matrix()
        return 500 * local[:, :2] / local[:, 2:] + [320, 240] + rng.normal(scale=0.5, size=(300, 2))

    turned = [VerifiedPair(0, 1, np.stack([pixels([0, 0, 0], 0), pixels([0, 0, 0], 0.1 * n)])) for n in (1, 2, 3)]
    stepped = [
        VerifiedPair(0, 1, np.stack([pixels([0, 0, 0], 0), pixels([0.3 * n, 0, 0], 0.1 * n)])) for n in (1, 2, 3)
    ]
    assert share_of_rotation(turned, [SIZE] * 2) > 0.85
    assert share_of_rotation(stepped, [SIZE] * 2) < 0.5


def features(rng, base=None):
    """Descriptors near those of a base."""
    values = rng.normal(size=(300, 128)) if base is None else base + 0.02 * rng.normal(size=base.shape)
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    keypoints = np.concatenate([rng.uniform(0, 500, (300, 2)), rng.uniform(1, 9, (300, 1)), np.zeros((300, 1))], 1)
    return Features(keypoints.astype(np.float32), values.astype(np.float32))


def test_few_photographs_are_matched_with_all(rng):
    assert pairs_to_match([features(rng)] * 4, ordered=False) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert pairs_to_match([features(rng)], ordered=False) == []


def test_many_photographs_are_matched_with_those_that_look_alike(rng):
    bases = [rng.normal(size=(300, 128)) for _ in range(4)]
    group = [number % 4 for number in range(32)]
    pairs = pairs_to_match([features(rng, bases[one]) for one in group], ordered=False)
    assert len(pairs) == 4 * (8 * 7 // 2)
    assert all(group[first] == group[second] for first, second in pairs)


def test_frames_of_a_video_are_matched_with_neighbours_and_returns(rng):
    pairs = pairs_to_match([features(rng) for _ in range(20)], ordered=True)
    steps = {second - first for first, second in pairs}
    assert steps == {1, 2, 3, 4, 5, 10} and len(pairs) == sum(20 - step for step in steps)
    looping = [features(rng) for _ in range(40)]
    looping[39] = Features(looping[0].keypoints, looping[0].descriptors)
    assert (0, 39) in pairs_to_match(looping, ordered=True)
