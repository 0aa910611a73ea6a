"""Cameras found in exact pictures of a known world."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from anystyle.examples import resolved
from anystyle_captures.sfm.colmap import match
from anystyle_captures.sfm.model import Photograph, SearchOptions
from anystyle_captures.sfm.trust import agreement
from anystyle_captures.structure_from_motion import find_cameras
from tests.support.cards import World, arc, panorama
from tests.support.real_data import real

FOCAL, SIZE = 200.0, (168, 192)


def solve(photographs, **options):
    return find_cameras(photographs, searches=(SearchOptions(min_side=256, max_side=256),), **options)


def photographs(poses, *, radial=0.0, seed=0, prefix="view"):
    world = World(seed)
    return [
        Photograph(f"{prefix}{number}", world.picture(pose, FOCAL, SIZE, radial)) for number, pose in enumerate(poses)
    ]


def of_folder(folder):
    return [Photograph(path.name, np.asarray(Image.open(path).convert("RGB"))) for path in sorted(folder.glob("*.jpg"))]


@pytest.fixture(scope="module")
def orbit():
    poses = arc(6, 40)
    return poses, photographs(poses)


@pytest.fixture(scope="module")
def solved(orbit):
    return solve(orbit[1])


def test_cameras_are_found(orbit, solved):
    poses, _ = orbit
    model = solved.model
    assert solved.verdict.trust == "good" and solved.verdict.reasons == ()
    assert model.registered.all()
    difference = agreement(model.world_from_camera, poses)
    assert difference.rotation.max() < 0.3 and difference.position.max() < 0.02
    np.testing.assert_allclose(model.lenses[:, 0], FOCAL, rtol=0.02)
    np.testing.assert_allclose(model.lenses[:, 1:3], np.tile([SIZE[1] / 2, SIZE[0] / 2], (6, 1)), atol=1e-6)
    for view, pose in enumerate(model.world_from_camera):
        local = (model.points[model.seen[:, view]] - pose[:3, 3]) @ pose[:3, :3]
        pixel = model.lenses[view, 0] * local[:, :2] / local[:, 2:] + model.lenses[view, 1:3]
        assert len(local) > 50 and (local[:, 2] > 0).all()
        assert (pixel > -3).all() and (pixel < np.array([SIZE[1], SIZE[0]]) + 3).all()


@pytest.mark.slow
def test_any_order_of_photographs_gives_the_same_cameras(orbit, solved, tmp_path, monkeypatch):
    """Bit for bit, in the order given; the cache serves every order, except that of frames of a video."""
    order = [3, 5, 0, 4, 1, 2]
    exchanged = [orbit[1][view] for view in order]
    monkeypatch.setenv("ANYSTYLE_CACHE", str(tmp_path))
    again = solve(exchanged, keep=True)
    expected = solved.model.reordered(np.argsort(order).tolist())
    for name, value in vars(again.model).items():
        np.testing.assert_array_equal(value, getattr(expected, name))
    assert not again.cached and solve(orbit[1], keep=True).cached
    assert not solve(exchanged, keep=True, ordered=True).cached


@pytest.mark.slow
def test_any_number_of_threads_gives_the_same_cameras():
    """In real photographs, whose equations the solver sums in another order on more threads."""
    photographs = of_folder(resolved(Path("example:street")))[:6]
    searches = (SearchOptions(max_side=512),)
    one, three = (find_cameras(photographs, searches=searches, threads=threads).model for threads in (1, 3))
    assert one.registered.sum() == 6
    for name, value in vars(one).items():
        np.testing.assert_array_equal(value, getattr(three, name))


def test_no_feature_is_taken_of_what_is_masked(orbit, tmp_path):
    mask = np.zeros(SIZE, dtype=np.uint8)
    mask[:, : SIZE[1] // 2] = 255
    masked = [replace(photograph, mask=mask) for photograph in orbit[1][:3]]
    for name in ("all", "one"):
        (tmp_path / name).mkdir()
    graph = match(tmp_path / "all", masked, SearchOptions(min_side=256, max_side=256))
    assert graph.pairs and all(pair.pixels[..., 0].max() <= 128 for pair in graph.pairs)
    few = match(tmp_path / "one", [masked[0], *orbit[1][1:3]], SearchOptions(min_side=256, max_side=256))
    assert len(few.pairs) == 3 and max(pair.pixels[..., 0].max() for pair in few.pairs) > 192  # the others count whole


@pytest.mark.slow
def test_photographs_of_two_lenses():
    poses, world = arc(8, 40), World(0)
    truth = [200.0, 260.0] * 4
    shots = [
        Photograph(str(number), world.picture(pose, focal, SIZE), lens=f"{focal:.0f}")
        for number, (pose, focal) in enumerate(zip(poses, truth, strict=True))
    ]
    found = solve(shots)
    assert found.verdict.trust == "good" and found.model.registered.all()
    np.testing.assert_allclose(found.model.lenses[:, 0], truth, rtol=0.03)


def test_exif_describes_the_lens():
    exif = Image.Exif()
    exif[ExifTags.Base.Model] = "Camera 1"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 36
    pixels = np.zeros((200, 300, 3), dtype=np.uint8)
    # A frame of 3:2 is 36 mm wide.
    photograph = Photograph.from_exif("a", pixels, exif)
    assert photograph.focal_length == pytest.approx(300, rel=1e-9) and photograph.lens == "Camera 1"
    precise = Image.Exif()
    details = precise.get_ifd(ExifTags.IFD.Exif)
    details |= {ExifTags.Base.FocalLength: 5.0, ExifTags.Base.ExifImageWidth: 3000, ExifTags.Base.ExifImageHeight: 2000}
    details |= {ExifTags.Base.FocalPlaneXResolution: 500.0, ExifTags.Base.FocalPlaneResolutionUnit: 4}
    # 5 mm at 500 pixels a millimetre are 2500 pixels of 3000.
    assert Photograph.from_exif("a", pixels, precise).focal_length == pytest.approx(250, rel=1e-9)
    details[ExifTags.Base.FocalPlaneXResolution] = float("nan")
    assert Photograph.from_exif("a", pixels, precise).focal_length is None
    assert Photograph.from_exif("a", pixels, Image.Exif()).lens == ""


def two_rooms(per_room):
    return [*photographs(arc(per_room, 10), prefix="a"), *photographs(arc(per_room, 10), seed=5, prefix="b")]


@pytest.mark.parametrize(
    ("capture", "reason"),
    [
        pytest.param(lambda: photographs(panorama(6, 40)), "turned without moving", marks=pytest.mark.slow),
        (lambda: two_rooms(1), "do not overlap: no two"),
        (lambda: two_rooms(2), "do not overlap: only"),
        (lambda: [Photograph(str(number), np.full((96, 128, 3), 190, np.uint8)) for number in range(4)], "too little"),
        (lambda: photographs(arc(2, 10)), "2 photographs overlap, and at least 3"),
        (lambda: photographs(arc(1, 10)), "one photograph shows no depth"),
    ],
    ids=["turning", "two rooms", "two pairs", "blank", "two", "one"],
)
def test_a_capture_that_cannot_work(capture, reason):
    found = solve(capture())
    assert found.verdict.trust == "failed" and not found.model.registered.any()
    assert reason in found.verdict.reasons[0]


def test_a_stranger_among_photographs(orbit):
    """It is left out; photographs that have no more pixels are not searched again, which would find wrong places."""
    found = find_cameras(
        [*orbit[1][:4], *photographs(arc(1, 0), seed=5, prefix="stranger")],
        searches=[SearchOptions(min_side=side, max_side=side) for side in (256, 320)],
    )
    assert found.model.registered.tolist() == [True] * 4 + [False] and found.verdict.trust == "good"
    assert found.verdict.reasons == ("left out, as nothing is shared with any other photograph: stranger0",)
    assert found.verdict.measures["searched_pixels"] == 256


def test_photographs_left_out_are_searched_again_at_more_pixels(orbit, caplog):
    searches = [SearchOptions(min_side=side, max_side=side) for side in (96, 192, 256)]
    with caplog.at_level("INFO"):
        found = find_cameras(orbit[1], searches=searches)
    assert caplog.text.count("of 6 photographs have a camera by SIFT at 96 pixels") == 1
    assert found.verdict.trust == "good" and found.model.registered.all()
    assert found.verdict.measures["searched_pixels"] == 192


def test_the_example_needs_no_second_search():
    """The incremental mapper finds 7 of its 12 cameras, and the global one, by 100 tracks a photograph, none."""
    found = find_cameras(of_folder(resolved(Path("example:street"))))
    assert found.verdict.trust == "good" and found.model.registered.all()
    assert found.verdict.measures["searched_pixels"] == 768


@pytest.mark.slow
@pytest.mark.parametrize(("capture", "least"), [("banana", 14), ("street", 29)])
def test_no_photograph_is_left_behind(capture, least):
    """The first search finds 8 of 16 and 10 of 29."""
    shots = of_folder(real(f"captures/{capture}"))
    found = find_cameras(shots)
    assert found.verdict.trust == "good" and found.model.registered.sum() >= least
    assert found.verdict.measures["searched_pixels"] == max(shots[0].size)


def test_names_are_distinct(orbit):
    with pytest.raises(ValueError, match="2 photographs with 1 names"):
        solve([orbit[1][0]] * 2)
    with pytest.raises(ValueError, match="give one or more"):
        solve([])


def test_a_search_keeps_signal_handlers_and_nothing_is_imported_before_it():
    """Importing pycolmap replaces handlers to print a native stack, and crashes Pillow where it comes first."""
    lines = """
import os, signal, sys
from anystyle_captures.sfm.colmap import load_pycolmap
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
assert "pycolmap" not in sys.modules
load_pycolmap()
os.kill(os.getpid(), signal.SIGTERM)
"""
    assert subprocess.run([sys.executable, "-c", lines], check=False).returncode == 7


def test_without_pycolmap(monkeypatch, orbit):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ImportError, match="pip install pycolmap"):
        solve(orbit[1][:3])


@pytest.mark.slow
def test_steps_too_wide_in_real_frames_are_reported():
    """Both mappers misplace the last of these frames and report nothing; the others are right."""
    folder = real("scenes/train")
    frames = [0, 4, 8, 12, 16, 20]
    shots = [
        Photograph(f"{frame:02d}", np.asarray(Image.open(folder / "images" / f"{frame + 1:05d}.png").convert("RGB")))
        for frame in frames
    ]
    rows = np.load(folder / "poses_bounds.npy")[:, :15].reshape(-1, 3, 5)
    truth = np.tile(np.eye(4), (len(rows), 1, 1))
    truth[:, :3] = np.stack([rows[:, :, 1], rows[:, :, 0], -rows[:, :, 2], rows[:, :, 3]], -1)
    found = find_cameras(shots)
    kept = np.flatnonzero(found.model.registered)
    assert 3 <= len(kept) < len(frames) and "left out" in found.verdict.reasons[-1]
    difference = agreement(found.model.world_from_camera[kept], truth[np.array(frames)[kept]])
    assert difference.rotation.max() < 2 and difference.position.max() < 0.1
