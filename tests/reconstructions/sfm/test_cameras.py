"""Cameras found in exact pictures of a known world."""

import sys

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from anystyle.reconstructions.sfm.cameras import cameras_from_photographs
from anystyle.reconstructions.sfm.model import Lens, pinhole, undistorted_image, undistorted_rays
from anystyle.reconstructions.sfm.photographs import (
    Enlargement,
    Photograph,
    photograph_with_exif,
    photographs_from_tensor,
)
from anystyle.reconstructions.sfm.support import agreement
from real_data import real
from reconstructions.sfm.cards import World, arc, panorama

FOCAL, SIZE = 200.0, (168, 192)


def solve(photographs, **options):
    return cameras_from_photographs(photographs, **{"sides": (256, 256)} | options)


def photographs(poses, *, focal=FOCAL, radial=0.0, seed=0, prefix="view"):
    world = World(seed)
    return [
        Photograph(f"{prefix}{number}", world.picture(pose, focal, SIZE, radial)) for number, pose in enumerate(poses)
    ]


@pytest.fixture(scope="module")
def orbit():
    poses = arc(6, 40)
    return poses, photographs(poses)


@pytest.fixture(scope="module")
def solved(orbit):
    return solve(orbit[1])


def test_cameras_are_found(orbit, solved):
    poses, _ = orbit
    assert solved.verdict.trust == "good" and solved.verdict.reasons == ()
    assert solved.registered.all()
    difference = agreement(solved.world_from_camera, poses)
    assert difference.rotation.max() < 0.3 and difference.position.max() < 0.02
    np.testing.assert_allclose(solved.intrinsics[:, 0, 0], FOCAL, rtol=0.02)
    np.testing.assert_allclose(solved.intrinsics[:, :2, 2], np.tile([SIZE[1] / 2, SIZE[0] / 2], (6, 1)), atol=1e-6)


def test_points_are_seen_where_tracks_say(solved):
    tracks = solved.tracks
    pose, lens = solved.world_from_camera[tracks.view], solved.intrinsics[tracks.view]
    local = np.einsum("oji,oj->oi", pose[:, :3, :3], solved.points[tracks.point] - pose[:, :3, 3])
    seen = np.einsum("oij,oj->oi", lens, local)
    error = np.linalg.norm(seen[:, :2] / seen[:, 2:] - tracks.pixel, axis=1)
    assert len(solved.points) > 300 and (local[:, 2] > 0).all()
    assert np.median(error) < 0.5


def test_the_same_photographs_give_the_same_cameras(orbit, solved):
    again = solve(orbit[1])
    np.testing.assert_array_equal(again.world_from_camera, solved.world_from_camera)
    np.testing.assert_array_equal(again.points, solved.points)


def test_any_order_of_photographs_gives_the_same_cameras(orbit, solved, tmp_path, monkeypatch):
    """Bit for bit, in the order given; what is kept of one order is found in another, and a path stays as it is."""
    order = [3, 5, 0, 4, 1, 2]
    exchanged = [orbit[1][view] for view in order]
    again = solve(exchanged)
    assert again.names == tuple(f"view{view}" for view in order)
    np.testing.assert_array_equal(again.world_from_camera, solved.world_from_camera[order])
    np.testing.assert_array_equal(again.intrinsics, solved.intrinsics[order])
    np.testing.assert_array_equal(again.points, solved.points)
    np.testing.assert_array_equal(np.array(order)[again.tracks.view], solved.tracks.view)
    np.testing.assert_array_equal(again.images[0], solved.images[3])
    monkeypatch.setenv("ANYSTYLE_CACHE", str(tmp_path))
    assert [solve(given, keep=True).kept for given in (orbit[1], exchanged)] == [False, True]
    assert not solve(exchanged, keep=True, ordered=True).kept


def test_progress_is_told(orbit):
    told = []
    solve(orbit[1][:3], progress=lambda *step: told.append(step))
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert stages == ["features", "matches", "cameras"]
    for stage in stages:
        steps = [(done, total) for name, done, total in told if name == stage]
        assert steps == sorted(steps) and steps[-1][0] == steps[-1][1]


def test_a_barrel_is_made_straight():
    poses = arc(6, 40)
    found = solve(photographs(poses, radial=-0.2))
    difference = agreement(found.world_from_camera, poses)
    assert found.verdict.trust == "good"
    assert difference.rotation.max() < 0.5 and difference.position.max() < 0.03
    # The found pinhole's pictures are what such a pinhole would have taken there.
    exact = World(0).picture(poses[2], found.intrinsics[2, 0, 0], SIZE)
    error = (found.images[2].astype(float) - exact) / 255
    assert np.sqrt(np.square(error).mean()) < 0.06
    plain = (photographs(poses[2:3], radial=-0.2)[0].pixels.astype(float) - exact) / 255
    assert np.sqrt(np.square(plain).mean()) > 1.5 * np.sqrt(np.square(error).mean())


@pytest.mark.parametrize("radial", [-0.25, -0.05, 0.1])
def test_undistorted_images_are_full_and_exact(radial):
    lens = Lens((FOCAL, FOCAL), (SIZE[1] / 2, SIZE[0] / 2), radial, SIZE)
    straight = pinhole(lens)
    pose = arc(3, 30)[0]
    made = undistorted_image(World(1).picture(pose, FOCAL, SIZE, radial), lens)
    exact = World(1).picture(pose, straight.focal[0], SIZE)
    assert np.sqrt(np.square((made.astype(float) - exact) / 255).mean()) < 0.05
    assert (straight.focal[0] < FOCAL) == (radial < 0)
    # Pixels of the border look at the border of the photograph, and at nothing outside.
    corners = np.array([[0.0, 0], [SIZE[1], 0], [SIZE[1] / 2, 0], [0, SIZE[0] / 2]])
    rays = (corners - straight.center) / straight.focal
    seen = rays * (1 + radial * np.square(rays).sum(1, keepdims=True)) * lens.focal + lens.center
    assert (seen >= -1e-6).all() and (seen <= np.array([SIZE[1], SIZE[0]]) + 1e-6).all()
    np.testing.assert_allclose(undistorted_rays(lens, seen), rays, atol=1e-9)


def test_photographs_of_two_lenses():
    poses, world = arc(8, 40), World(0)
    focals = [200.0, 260.0] * 4
    shots = [
        Photograph(str(number), world.picture(pose, focal, SIZE), lens=f"{focal:.0f}")
        for number, (pose, focal) in enumerate(zip(poses, focals, strict=True))
    ]
    found = solve(shots)
    assert found.verdict.trust == "good" and found.registered.all()
    np.testing.assert_allclose(found.intrinsics[:, 0, 0], focals, rtol=0.03)


def test_exif_tells_the_lens():
    exif = Image.Exif()
    exif[ExifTags.Base.Model] = "Camera 1"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 36
    pixels = np.zeros((200, 300, 3), dtype=np.uint8)
    # A frame of 3:2 is 36 mm wide.
    found = photograph_with_exif("a", pixels, exif)
    assert found.focal_length == pytest.approx(300, rel=1e-9) and found.lens == "Camera 1"
    precise = Image.Exif()
    details = precise.get_ifd(ExifTags.IFD.Exif)
    details |= {ExifTags.Base.FocalLength: 5.0, ExifTags.Base.ExifImageWidth: 3000, ExifTags.Base.ExifImageHeight: 2000}
    details |= {ExifTags.Base.FocalPlaneXResolution: 500.0, ExifTags.Base.FocalPlaneResolutionUnit: 4}
    # 5 mm at 500 pixels a millimetre are 2500 pixels of 3000.
    assert photograph_with_exif("a", pixels, precise).focal_length == pytest.approx(250, rel=1e-9)
    details[ExifTags.Base.FocalPlaneXResolution] = float("nan")
    assert photograph_with_exif("a", pixels, precise).focal_length is None
    assert photograph_with_exif("a", pixels, Image.Exif()).lens == ""


def test_a_known_focal_length_helps_three_views():
    poses = arc(3, 15)
    shots = [Photograph(one.name, one.pixels, focal_length=FOCAL) for one in photographs(poses)]
    found = solve(shots)
    assert found.registered.all()
    assert agreement(found.world_from_camera, poses).rotation.max() < 0.5


def test_a_camera_that_turns():
    found = solve(photographs(panorama(6, 40)))
    assert found.verdict.trust == "failed" and not found.registered.any()
    assert "turned without moving" in found.verdict.reasons[0]


def test_different_rooms():
    first, second = arc(2, 10), arc(2, 10)
    two = [*photographs(first[:1], seed=0, prefix="a"), *photographs(second[:1], seed=5, prefix="b")]
    verdict = solve(two).verdict
    assert verdict.trust == "failed" and "do not overlap: no two" in verdict.reasons[0]
    four = [*photographs(first, seed=0, prefix="a"), *photographs(second, seed=5, prefix="b")]
    assert "do not overlap: only" in solve(four).verdict.reasons[0]


def test_a_stranger_among_photographs(orbit):
    found = solve([*orbit[1][:4], *photographs(arc(1, 0), seed=5, prefix="stranger")])
    assert found.registered.tolist() == [True] * 4 + [False]
    assert found.verdict.trust == "good"
    assert found.verdict.reasons == ("stranger0 shares nothing with any other photograph and was left out",)
    np.testing.assert_array_equal(found.images[4], World(5).picture(arc(1, 0)[0], FOCAL, SIZE))


def test_a_blank_wall_and_too_few():
    wall = np.full((96, 128, 3), 190, dtype=np.uint8)
    verdict = solve([Photograph(str(number), wall) for number in range(4)]).verdict
    assert verdict.trust == "failed" and "too little to see" in verdict.reasons[0]
    pair = photographs(arc(2, 10))
    assert "2 photographs overlap, and at least 3" in solve(pair).verdict.reasons[0]
    alone = solve(pair[:1])
    assert "one photograph shows no depth" in alone.verdict.reasons[0]
    assert np.isnan(alone.intrinsics).all() and alone.points.shape == (0, 3)


def test_names_are_distinct():
    one = photographs(arc(1, 0))[0]
    with pytest.raises(ValueError, match="2 photographs with 1 names"):
        solve([one, one])
    with pytest.raises(ValueError, match="give one or more"):
        solve([])


def test_without_pycolmap(monkeypatch, orbit):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    for name in [name for name in sys.modules if name.startswith("anystyle.reconstructions.sfm.")]:
        if name.endswith(("database", "mapping")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("anystyle.reconstructions.sfm.database", raising=False)
    with pytest.raises(ImportError, match="pip install pycolmap"):
        solve(orbit[1][:3])


def test_tensors_are_photographs():
    images = torch.rand(2, 3, 8, 10)
    first, second = photographs_from_tensor(images, ["a", "b"])
    assert (first.name, second.size) == ("a", (8, 10))
    np.testing.assert_allclose(second.pixels, images[1].permute(1, 2, 0) * 255, atol=0.51)
    assert photographs_from_tensor(images, ())[1].name == "1"


def test_sizes_for_features():
    assert Enlargement.between((100, 200), 512, 1024).scaled == (256, 512)
    assert Enlargement.between((700, 400), 512, 1024).scaled == (700, 400)
    assert Enlargement.between((3000, 4000), 512, 1024) == Enlargement((3000, 4000), (768, 1024))
    assert Enlargement((3000, 4000), (768, 1024)).factors == (0.256, 0.256)


def test_steps_too_wide_in_real_frames_are_told():
    """Both mappers place the last of these frames wrongly and without complaint; the others are right."""
    folder = real("scenes/train")
    frames = [0, 4, 8, 12, 16, 20]
    shots = [
        Photograph(f"{frame:02d}", np.asarray(Image.open(folder / "images" / f"{frame + 1:05d}.png").convert("RGB")))
        for frame in frames
    ]
    rows = np.load(folder / "poses_bounds.npy")[:, :15].reshape(-1, 3, 5)
    truth = np.tile(np.eye(4), (len(rows), 1, 1))
    truth[:, :3] = np.stack([rows[:, :, 1], rows[:, :, 0], -rows[:, :, 2], rows[:, :, 3]], -1)
    found = cameras_from_photographs(shots)
    kept = np.flatnonzero(found.registered)
    assert 3 <= len(kept) < len(frames) and "left out" in found.verdict.reasons[-1]
    reference = truth[np.array(frames)[kept]]
    difference = agreement(found.world_from_camera[kept], reference)
    assert difference.rotation.max() < 2 and difference.position.max() < 0.1
    assert Rotation.from_matrix(found.world_from_camera[kept][:, :3, :3]).as_quat().shape == (len(kept), 4)
