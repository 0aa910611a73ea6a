"""Paths, projections and what files say of them."""

import json
import math
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from PIL import Image

from anystyle.contracts import Format, Renderer
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.geometry.confidence import ViewConfidence
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.io.video import opened, write_video
from anystyle.registry.build import build
from anystyle.renderers.auto import AutoRenderer
from anystyle.testing import asserts, inputs
from anystyle.testing.inputs import images
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle_film.command import FilmCommand
from anystyle_film.keyframes import Keyframes
from anystyle_film.metadata import mark_video
from anystyle_film.mp4 import PROJECTIONS, Mp4
from anystyle_film.paths import FilmedScene, orbit, smooth, spiral
from anystyle_film.projection import Projection

AROUND = Projection(degrees=360)


def cameras(poses, size=(48, 64), focal=60.0):
    intrinsics = torch.tensor([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]])
    return Cameras(poses.float()[None], intrinsics.repeat(1, len(poses), 1, 1), size)


def sphere(number, color):
    """Gaussians that cover a sphere of radius 1 around the origin, with a colour for each direction."""
    height = 1 - 2 * (torch.arange(number) + 0.5) / number
    turn = torch.arange(number) * math.pi * (3 - math.sqrt(5))
    flat = (1 - height.square()).sqrt()
    means = torch.stack([flat * turn.cos(), height, flat * turn.sin()], dim=1)
    size = 0.6 * math.sqrt(4 * math.pi / number)
    return Gaussians(
        means[None],
        torch.tensor([[1.0, 0, 0, 0]]).expand(1, number, 4),
        torch.full((1, number, 3), size),
        torch.full((1, number), 0.95),
        constant_from_rgb(color(means))[None, :, None],
    )


def noise(direction):
    return torch.rand(direction.shape, generator=torch.Generator().manual_seed(0))


def directions(height, width, degrees):
    """Of the pixels of an equirectangular frame, in OpenCV's axes of its camera."""
    across = ((torch.arange(width) + 0.5) / width - 0.5) * math.radians(degrees)
    down = ((torch.arange(height) + 0.5) / height - 0.5)[:, None] * math.pi
    return torch.stack([down.cos() * across.sin(), down.sin().expand(-1, width), down.cos() * across.cos()])


def rendered(scene, views):
    """The images of all cameras, each rendered by itself."""
    renderer = build(Renderer, "auto")
    with torch.no_grad():
        return torch.stack([renderer(scene, views.select([i])).color[0, 0] for i in range(views.intrinsics.shape[1])])


def filmed(projection, scene, camera, height):
    """One frame."""
    size = projection.size(camera, 1.0, height)
    views = projection.views(FilmedScene(scene, camera), camera, size)
    return projection.frame(rendered(scene, views), size)


def psnr(first, second):
    return float(-10 * (first - second).square().mean().log10())


def test_a_panorama_shows_each_direction_where_the_closed_form_has_it():
    scene = sphere(20_000, lambda direction: 0.5 + 0.4 * direction)
    frame = filmed(AROUND, scene, cameras(torch.eye(4)[None]), 96)
    assert frame.shape == (3, 96, 192)
    error = (frame - (0.5 + 0.4 * directions(96, 192, 360))).abs()
    assert error.mean() < 0.006 and error.max() < 0.02  # Gaussians are wide
    # The horizon of a camera that is turned, pitched and rolled stays level, and the heading is in the middle.
    turned = look_at(torch.zeros(3), torch.tensor([1.0, 0.3, 0.0]), F.normalize(torch.tensor([0.0, -1.0, 0.2]), dim=0))
    views = AROUND.views(FilmedScene(scene, cameras(torch.eye(4)[None])), cameras(turned[None]), (96, 192))
    assert psnr(AROUND.frame(rendered(scene, views), (96, 192)), frame.roll(-48, 2)) > 40


def test_a_crop_of_a_panorama_is_the_pinhole_render():
    scene, pose = sphere(2000, noise), torch.eye(4)
    pose[:3, 3] = torch.tensor([0.1, 0.05, -0.1])
    camera = cameras(pose[None], (96, 128), 100.0)
    panorama = filmed(AROUND, scene, camera, 400)
    (pinhole,) = rendered(scene, camera)
    y, x = torch.meshgrid((torch.arange(96) + 0.5 - 48) / 100, (torch.arange(128) + 0.5 - 64) / 100, indexing="ij")
    longitude, latitude = torch.atan(x), torch.atan2(y, (1 + x.square()).sqrt())
    where = torch.stack([longitude / math.pi, latitude / (math.pi / 2)], -1)
    crop = F.grid_sample(panorama[None], where[None], align_corners=False)[0]
    assert psnr(crop, pinhole) > 50


def test_each_half_of_vr180_is_the_front_of_the_panorama_of_one_eye():
    scene = sphere(600, noise)
    frame = filmed(Projection(180, stereo=True, baseline=0.2), scene, cameras(torch.eye(4)[None]), 64)
    for half, x in zip(frame.chunk(2, dim=2), (-0.1, 0.1), strict=True):
        pose = torch.eye(4)
        pose[0, 3] = x
        assert psnr(half, filmed(AROUND, scene, cameras(pose[None]), 64)[:, :, 32:96]) > 60


def test_eyes_are_a_baseline_apart_and_meet_at_the_distance():
    scene = FilmedScene(sphere(500, torch.zeros_like), cameras(torch.eye(4)[None]))
    assert scene.distance == pytest.approx(1, abs=0.1)
    camera = scene.cameras
    pair = Projection(stereo=True, baseline=0.07).views(scene, camera, (48, 128))
    torch.testing.assert_close(pair.world_from_camera[0, :, :3, 3], torch.tensor([[-0.035, 0, 0], [0.035, 0, 0]]))
    assert torch.equal(pair.world_from_camera[0, :, :3, :3], torch.eye(3).expand(2, 3, 3))
    local = torch.tensor([0.1, 0.1, scene.distance]) - pair.world_from_camera[0, :, :3, 3]
    pixels = (pair.intrinsics[0] @ local[..., None])[..., 0]
    torch.testing.assert_close(pixels[0] / pixels[0, 2], pixels[1] / pixels[1, 2])


def test_an_orbit_looks_at_the_center_from_a_constant_radius():
    """Cameras around a point look down at it; up is tilted against the axes of the world."""
    turn = 2 * math.pi * torch.arange(7).double()[:, None] / 12
    center, up, ahead = torch.tensor([[3, 0, -1], [math.sin(0.3), -math.cos(0.3), 0], [0, 0, 1]]).double()
    eyes = center + 2 * (turn.cos() * ahead + turn.sin() * torch.linalg.cross(up, ahead)) + 1.5 * up
    scene = FilmedScene(sphere(200, torch.zeros_like), cameras(look_at(eyes, center.expand_as(eyes), up)))
    torch.testing.assert_close(scene.focus, center, atol=0.1, rtol=0)
    assert float(scene.up @ up) > math.cos(math.radians(1))
    path = orbit(scene, 40).world_from_camera[0].double()
    offsets = path[:, :3, 3] - scene.focus
    torch.testing.assert_close(F.normalize(-offsets, dim=1), path[:, :3, 2], atol=1e-5, rtol=0)
    for constant in (offsets.norm(dim=1), offsets @ scene.up, (offsets - offsets.roll(1, 0)).norm(dim=1)):
        torch.testing.assert_close(constant, constant[:1].expand(40), atol=1e-5, rtol=0)
    assert float(offsets[0].norm()) == pytest.approx(2.5, abs=0.1)


KEYS = [
    {"time": 1, "position": [0, 0, -1], "look_at": [0, 0, 2], "fov": 60},
    {"time": 1.5, "position": [1, 0, 0], "look_at": [0, 0, 2], "fov": 30},
    {"time": 3, "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]},
]


def test_a_path_goes_through_its_keyframes_at_their_times(tmp_path):
    (tmp_path / "path.json").write_text(json.dumps({"keyframes": KEYS, "up": [0, -1, 0]}))
    scene = FilmedScene(sphere(50, torch.zeros_like), cameras(torch.eye(4)[None]))
    keyframes = Keyframes(str(tmp_path / "path.json"))
    assert keyframes.seconds == 2
    path = keyframes(scene, 41)
    poses, focal = path.world_from_camera[0, [0, 10, 40]], path.intrinsics[0, [0, 10, 40], 1, 1]
    positions = torch.tensor([[0.0, 0, -1], [1, 0, 0], [0, 1, 0]])
    torch.testing.assert_close(poses[:, :3, 3], positions)
    ahead = F.normalize(torch.tensor([[0.0, 0, 3], [-1, 0, 2], [0, 0, 1]]), dim=1)
    torch.testing.assert_close(poses[:, :3, 2], ahead, atol=1e-5, rtol=0)
    half = torch.tensor([30.0, 15.0, math.degrees(math.atan(24 / 60))])
    torch.testing.assert_close(focal, 24 / half.deg2rad().tan())


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"time": 1}, "time 1 is not after"),
        ({"look_at": None}, "give either position and look_at, or world_from_camera"),
        ({"look_at": [1, 0, 0]}, "are the same point"),
        ({"fov": 500}, "fov"),
        ({"zoom": 2}, "zoom"),
        ({"position": [1, 2]}, "position"),
        ({"position": None, "look_at": None, "world_from_camera": np.diag([2, 1, 1, 1]).tolist()}, "is not a rotation"),
    ],
)
def test_keyframes_that_make_no_sense_are_a_line(change, expected, tmp_path):
    (tmp_path / "path.json").write_text(json.dumps({"keyframes": [KEYS[0], {**KEYS[1], **change}]}))
    with pytest.raises(UserError, match=expected) as raised:
        Mp4(path=str(tmp_path / "path.json"))
    assert len(str(raised.value).splitlines()) == 1 and "path.json" in str(raised.value)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"kind": "fisheye"}, "expected one of"),
        ({"path": "orbits"}, "Did you mean 'orbit'"),
        ({"path": "path.csv"}, "or a .json file of keyframes"),
        ({"path": "missing.json"}, "there is no file of keyframes missing.json"),
        ({"turns": 2.0}, "video.turns=2 has no meaning with video.path=smooth"),
        ({"path": "orbit", "turns": 0.0}, "video.turns=0"),
        ({"baseline": 0.1}, "video.baseline=0.1 has no meaning with video.kind=pinhole"),
        ({"kind": "stereo", "baseline": -1.0}, "format.baseline=-1.0: expected float > 0"),
        ({"height": 100_000}, "format.height=100000: expected 2 <= int <= 4320"),
    ],
)
def test_options_that_make_no_sense_are_a_line(options, expected):
    with pytest.raises(UserError, match=expected):
        build(Format, {"_target_": "anystyle_film.mp4.Mp4", **options})


def decoded(path):
    with opened(path) as container:
        return [frame.to_ndarray() for frame in container.decode(video=0)]


def test_marking_a_film_leaves_its_frames(tmp_path):
    path = tmp_path / "video.mp4"
    write_video(iter(images(5, (64, 128))), path)
    before = decoded(path)
    mark_video(path, Projection(degrees=180, stereo=True))
    np.testing.assert_array_equal(decoded(path), before)
    assert len(before) == 5


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        (Projection(), set()),
        (Projection(stereo=True), {"Stereo 3D: side by side"}),
        (Projection(degrees=360), {"Stereo 3D: 2D", "Spherical Mapping: equirectangular"}),
        (Projection(180, stereo=True), {"Stereo 3D: side by side", "Spherical Mapping: tiled equirectangular"}),
    ],
)
def test_ffmpeg_sees_what_a_film_is(layout, expected, tmp_path):
    ffprobe = shutil.which("ffprobe")
    if ffprobe is None:
        pytest.skip("ffprobe is not installed")
    write_video(iter(images(2, (64, 128))), tmp_path / "video.mp4")
    mark_video(tmp_path / "video.mp4", layout)
    words = [ffprobe, "-v", "error", "-show_streams", "-of", "json", str(tmp_path / "video.mp4")]
    (stream,) = json.loads(subprocess.run(words, capture_output=True, check=True).stdout)["streams"]
    rows = stream.get("side_data_list", [])
    assert {f"{row['side_data_type']}: {row.get('type', row.get('projection'))}" for row in rows} == expected
    tiled = [row for row in rows if row.get("projection") == "tiled equirectangular"]
    # A quarter of the sphere is cut off left and right, so that the whole would be twice as wide.
    assert all(abs(row["bound_left"] - 64) < 2 and abs(row["bound_right"] - 64) < 2 for row in tiled)


def test_stills_say_that_they_are_panoramas(tmp_path):
    styled = StyledScene((("red", sphere(50, torch.abs)),), cameras(torch.eye(4).repeat(4, 1, 1)), tuple("abcd"))
    Mp4(kind="equirectangular", frames=4, height=40, stills=2).write(styled, tmp_path / "video.mp4")
    stills = sorted((tmp_path / "stills").iterdir())
    assert [still.name for still in stills] == ["frame_00001.jpg", "frame_00003.jpg"]
    assert len(decoded(tmp_path / "video.mp4")) == 4
    with Image.open(stills[0]) as image:
        assert image.size == (80, 40)
        assert b'GPano:ProjectionType="equirectangular"' in image.info["xmp"]


SIZE = (48, 64)


@pytest.mark.parametrize("path_of", [smooth, orbit, spiral])
def test_a_path_has_one_camera_per_frame_and_moves_smoothly(path_of):
    scenes = {views: FilmedScene(inputs.gaussians(1, 50), inputs.cameras(1, views, SIZE)) for views in (1, 2, 5)}
    for scene in scenes.values():
        for frames in (1, 2, 25):
            path = path_of(scene, frames)
            assert path.intrinsics.shape[:2] == (1, frames)
            asserts.cameras(path, SIZE)
            asserts.finite(path, f"the path of {frames} frames")
    for column in (3, 2):  # positions, directions
        coarse, fine = (
            path_of(scenes[5], frames).world_from_camera[0, :, :3, column].diff(dim=0).norm(dim=1).max()
            for frames in (60, 120)
        )
        assert fine <= 0.7 * coarse + 1e-4


@pytest.mark.parametrize("projection", PROJECTIONS.values(), ids=PROJECTIONS)
def test_frames_have_even_sides_and_are_made_of_views_without_seams(projection):
    seen = inputs.cameras(1, 3, SIZE)
    heights = [projection.size(seen, scale, None)[0] for scale in (0.5, 1.0, 2.0)]
    assert heights == sorted(set(heights))
    for height in (36, 100):
        size = projection.size(seen, 1.0, height)
        assert size[0] == height and not any(side % 2 for side in size)
    size = projection.size(seen, 1.0, 40)
    views = projection.views(FilmedScene(inputs.gaussians(1, 50), seen), seen.select([1]), size)
    asserts.cameras(views, views.size)
    frame = projection.frame(torch.full((views.intrinsics.shape[1], 3, *views.size), 0.5), size)
    asserts.close(frame, torch.full((3, *size), 0.5), "a frame of grey images")


def test_beyond_what_was_photographed_a_film_fades_to_the_background_unless_told_not_to(tmp_path, caplog):
    """A ball that was photographed from one side within 20 degrees, from keyframes around it."""
    ball = sphere(3000, lambda direction: 0.2 + 0 * direction)
    ball = replace(ball, means=0.4 * ball.means, scales=0.4 * ball.scales)

    def seen_from(*degrees):
        turn = torch.tensor(degrees, dtype=torch.float64).deg2rad()
        eyes = 2 * torch.stack([turn.sin(), torch.zeros_like(turn), -turn.cos()], dim=1)
        return look_at(eyes, torch.zeros_like(eyes))

    turns, known = (0, 5, 10, 20, 35, 40, 45, 60, 120, 180), 4
    keys = [{"time": time, "world_from_camera": pose.tolist()} for time, pose in enumerate(seen_from(*turns))]
    (tmp_path / "around.json").write_text(json.dumps({"keyframes": keys}))
    scene = FilmedScene(ball, cameras(seen_from(0, 10, 20)))
    pictures = {}
    for fade, background in ((True, 1.0), (False, 1.0), (True, 0.0)):
        renderer = AutoRenderer(background=(background,) * 3)
        film = Mp4(renderer=renderer, path=str(tmp_path / "around.json"), fps=1, fade=fade)
        pictures[fade, background] = torch.stack(list(film._frames(scene, scene.cameras.size)))
    faded, whole = pictures[True, 1.0], pictures[False, 1.0]
    assert (faded[:known] == whole[:known]).all() and (whole.amin((1, 2, 3)) < 0.3).all()
    ink = (1 - faded).mean((1, 2, 3))
    assert (ink[known - 1 : -3].diff() < 0).all() and (ink[-3:] == 0).all()
    assert (pictures[True, 0.0][-3:] == 0).all()
    confidence = ViewConfidence.of(ball, scene.cameras)
    shares = [float(confidence(cameras(pose[None])).mean()) for pose in seen_from(*turns)]
    assert (line := caplog.messages[0]).startswith(f"{sum(share < 0.5 for share in shares)} of 10 views of the film")
    assert line == caplog.messages[1] and len(caplog.messages) == 2  # not by the film that fades nothing
    chosen = replace(scene, photographed=False)
    assert (torch.stack(list(film._frames(chosen, chosen.cameras.size)))[-1] > 0.1).any()


def test_the_command_writes_a_folder_or_the_file_that_it_is_told(tmp_path, capsys):
    inputs.gaussians(1, 20).save(tmp_path / "scene.ply")
    poses = [{"file_path": f"{i}.png", "transform_matrix": torch.eye(4).tolist()} for i in range(2)]
    (tmp_path / "transforms.json").write_text(
        json.dumps({"w": 64, "h": 48, "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "frames": poses})
    )
    for out, film in (("made", "made/video.mp4"), ("new/a.mp4", "new/a.mp4")):
        FilmCommand()([str(tmp_path / "scene.ply"), "--out", str(tmp_path / out), "video.frames=2", "video.height=48"])
        assert capsys.readouterr().out.strip().endswith(film)
        assert (tmp_path / film).is_file()
