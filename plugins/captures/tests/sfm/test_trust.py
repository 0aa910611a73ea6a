"""Wrong models are told from right ones."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anystyle_captures.sfm.model import SparseModel, VerifiedPair, ViewGraph, largest_features, pairs_to_match
from anystyle_captures.sfm.trust import agreement, judge, share_of_rotation, supported_views
from tests.support.cards import arc

VIEWS, SIZE = 6, (480, 640)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def right(rng):
    """The exact model in which each view sees some of the points."""
    lenses = np.tile([500.0, 320.0, 240.0, 0.0], (VIEWS, 1))
    return SparseModel(arc(VIEWS, 50), lenses, rng.uniform(-1, 1, (300, 3)), rng.random((300, VIEWS)) < 0.7)


@pytest.fixture
def graph(rng):
    pairs = [VerifiedPair(0, view, rng.uniform(0, 480, (2, 40, 2))) for view in range(1, VIEWS)]
    return ViewGraph([f"view{view}" for view in range(VIEWS)], [500] * VIEWS, [SIZE] * VIEWS, pairs)


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
    assert np.flatnonzero(~((odd.rotation <= 2.0) & (odd.position <= 0.1))).tolist() == [4]
    spread = np.sqrt(
        np.square(right.world_from_camera[:, :3, 3] - right.world_from_camera[:, :3, 3].mean(0)).sum(1).mean()
    )
    assert odd.position[4] == pytest.approx(0.8 / spread, rel=1e-6)


def test_a_view_hangs_on_points_of_three():
    """Points that two views see say nothing of how far apart they are."""
    seen = np.zeros((200, 5), dtype=bool)
    seen[:100, :3] = True  # three views that see the same
    seen[100:140, 2:4] = True  # a view that shares with one of them alone
    assert supported_views(seen, 30) == [0, 1, 2]
    seen[100:135, 1] = True  # and now with two
    assert supported_views(seen, 30) == [0, 1, 2, 3] and supported_views(seen, 36) == [0, 1, 2]
    assert supported_views(seen, 136) == []


def test_two_halves_joined_at_one_view_are_two():
    """Their relative size is open."""
    seen = np.zeros((300, 7), dtype=bool)
    seen[:100, :4] = True
    seen[100:280, 3:] = True
    assert supported_views(seen, 30) == [3, 4, 5, 6]


def others_displaced(model, rng):
    for view in range(VIEWS):
        model = displaced(model, view, tuple(rng.normal(size=3)))
    return model


def held_by_few(model):
    seen = model.seen.copy()
    seen[10:, 5] = False
    return replace(model, seen=seen)


@pytest.mark.parametrize(
    ("change", "confirmed", "trust", "reason", "missing"),
    [
        (lambda model: model, moved, "good", None, []),
        (lambda model: model, None, "doubtful", "only one of two methods", []),
        (lambda m: replace(m, lenses=m.lenses * [0.3, 1, 1, 0] - [0, 0, 0, 0.4]), moved, "failed", "", [*range(VIEWS)]),
        (
            held_by_few,
            lambda model, rng: moved(displaced(model, 5), rng),
            "good",
            "too little is shared with the others: view5",
            [5],
        ),
        (lambda m: replace(m, points=m.points * 0.1 + [0, 0, 400.0]), moved, "doubtful", "depth is uncertain", []),
        (lambda m: replace(m, points=m.points[:80], seen=m.seen[:80]), moved, "doubtful", "points hold these", []),
    ],
)
def test_what_speaks_against_cameras_is_told(graph, right, rng, change, confirmed, trust, reason, missing):
    model = change(right)
    found, verdict = judge(graph, [[model], [] if confirmed is None else [confirmed(model, rng)]])
    assert verdict.trust == trust and np.flatnonzero(~found.registered).tolist() == missing
    assert verdict.reasons == () if reason is None else reason in verdict.reasons[0]


def test_views_in_dispute_are_named_and_left_out_if_most_agree(graph, right, rng):
    found, verdict = judge(graph, [[displaced(right, 4)], [moved(right, rng)]])
    assert verdict.trust == "doubtful" and "disagree on the cameras of view4 " in verdict.reasons[0]
    assert np.flatnonzero(~found.registered).tolist() == [4]
    found, verdict = judge(graph, [[right], [others_displaced(right, rng)]])
    assert verdict.trust == "doubtful" and "disagree" in verdict.reasons[0] and found.registered.all()


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
    assert share_of_rotation(turned, [SIZE] * 2) > 0.85 and share_of_rotation(stepped, [SIZE] * 2) < 0.5


def preview(rng, base=None):
    """Descriptors near those of a base."""
    values = rng.normal(size=(300, 128)) if base is None else base + 0.02 * rng.normal(size=base.shape)
    return largest_features(np.tile(np.arange(300.0)[:, None], (1, 6)), values)


def test_previews_are_of_the_largest_features(rng):
    values = rng.normal(size=(300, 128)).astype(np.float32)
    turn = rng.uniform(-np.pi, np.pi, 300)
    shape = np.arange(300) * np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)])
    keypoints = np.concatenate([np.zeros((300, 2)), shape.T], 1)
    expected = values[::-1][:256] / np.linalg.norm(values[::-1][:256], axis=1, keepdims=True)
    np.testing.assert_allclose(largest_features(keypoints, values), expected, rtol=1e-6)


def test_many_photographs_are_matched_with_those_that_look_alike(rng):
    bases = [rng.normal(size=(300, 128)) for _ in range(4)]
    group = [number % 4 for number in range(32)]
    pairs = pairs_to_match([preview(rng, bases[one]) for one in group], ordered=False)
    assert len(pairs) == 4 * (8 * 7 // 2)
    assert all(group[first] == group[second] for first, second in pairs)


def test_frames_of_a_video_are_matched_with_neighbours_and_returns(rng):
    pairs = pairs_to_match([preview(rng) for _ in range(20)], ordered=True)
    steps = {second - first for first, second in pairs}
    assert steps == {1, 2, 3, 4, 5, 10} and len(pairs) == sum(20 - step for step in steps)
    looping = [preview(rng) for _ in range(40)]
    looping[39] = looping[0]
    assert (0, 39) in pairs_to_match(looping, ordered=True)
