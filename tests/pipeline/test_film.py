"""Camera paths of films, what a film shows, and the command that films a scene again."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from PIL import Image

from anystyle.commands import film as command
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.geometry.confidence import ViewConfidence
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.io.video import opened
from anystyle.pipeline.film import Film, along, orbit, read_flight, smooth
from anystyle.pipeline.options import VideoOptions
from anystyle.registry.compose import compose, options
from anystyle.renderers.auto import AutoRenderer
from anystyle.testing import asserts, inputs
from anystyle.types import Cameras, Gaussians, StyledScene
from tests.support.refusals import raises_line

SIZE = (48, 64)
FROM_Z_UP = torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)
"""From a world with x right, y forward, z up to one with x right, y down, z forward."""


def cameras(poses, size=SIZE, focal=60.0):
    intrinsics = torch.tensor([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]])
    return Cameras(poses.float()[None], intrinsics.repeat(1, len(poses), 1, 1), size)


def sphere(number, color=torch.zeros_like):
    """Gaussians that cover a sphere of radius 1 around the origin, with a colour for each direction."""
    height = 1 - 2 * (torch.arange(number) + 0.5) / number
    turn = torch.arange(number) * math.pi * (3 - math.sqrt(5))
    flat = (1 - height.square()).sqrt()
    means = torch.stack([flat * turn.cos(), height, flat * turn.sin()], dim=1)
    return Gaussians(
        means[None],
        torch.tensor([[1.0, 0, 0, 0]]).expand(1, number, 4),
        torch.full((1, number, 3), 0.6 * math.sqrt(4 * math.pi / number)),
        torch.full((1, number), 0.95),
        constant_from_rgb(color(means))[None, :, None],
    )


def path_file(folder, poses, fov=60.0, **changes):
    """As nerfstudio's viewer writes it: OpenGL's axes of cameras in a world whose z axis is up."""
    opengl = torch.linalg.inv(FROM_Z_UP) @ torch.as_tensor(poses).double() * torch.tensor([1.0, -1, -1, 1])
    frames = [{"camera_to_world": pose.flatten().tolist(), "fov": fov, "aspect": 1.5} for pose in opengl]
    content = {"camera_type": "perspective", "fps": 10, "seconds": 2, "keyframes": [], "smoothness_value": 0.5}
    content |= {"render_height": 480, "render_width": 720, "camera_path": frames}
    file = folder / "path.json"
    file.write_text(json.dumps({key: value for key, value in (content | changes).items() if value is not None}))
    return file


def frames_of(path):
    with opened(path) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_an_orbit_looks_at_the_center_from_a_constant_radius():
    """Cameras around a point look down at it; up is tilted against the axes of the world."""
    turn = 2 * math.pi * torch.arange(7).double()[:, None] / 12
    center, up, ahead = torch.tensor([[3, 0, -1], [math.sin(0.3), -math.cos(0.3), 0], [0, 0, 1]]).double()
    eyes = center + 2 * (turn.cos() * ahead + turn.sin() * torch.linalg.cross(up, ahead)) + 1.5 * up
    seen = cameras(look_at(eyes, center.expand_as(eyes), up))
    path = orbit(sphere(200), seen, 40).world_from_camera[0].double()
    torch.testing.assert_close((path[:, :3, 3] + 2.5 * path[:, :3, 2]).mean(0), center, atol=0.1, rtol=0)
    assert float(F.normalize(-path[:, :3, 1].mean(0), dim=0) @ up) > math.cos(math.radians(1))
    offsets = path[:, :3, 3] - center
    for constant in (offsets.norm(dim=1), offsets @ up):
        torch.testing.assert_close(constant, constant[:1].expand(40), atol=0.1, rtol=0)
    steps = (path[:, :3, 3] - path[:, :3, 3].roll(1, 0)).norm(dim=1)
    torch.testing.assert_close(steps, steps[:1].expand(40), atol=1e-5, rtol=0)
    assert float(offsets[0].norm()) == pytest.approx(2.5, abs=0.1)
    part = orbit(sphere(200), seen, 41, turns=0.25).world_from_camera[0].double()[:, :3, 3] - center
    level, middle = (
        F.normalize(offset - (offset @ up)[:, None] * up, dim=1) for offset in (part, (eyes - center).mean(0)[None])
    )
    assert math.degrees(math.acos(float(level[0] @ level[-1]))) == pytest.approx(90 * 40 / 41, abs=3)
    assert float(middle[0] @ F.normalize(level.mean(0), dim=0)) > math.cos(math.radians(2))


@pytest.mark.parametrize("path_of", [smooth, orbit])
def test_a_path_has_one_camera_per_frame_and_moves_smoothly(path_of):
    gaussians, seen = inputs.gaussians(1, 50), {views: inputs.cameras(1, views, SIZE) for views in (1, 2, 5)}
    for given in seen.values():
        for frames in (1, 2, 25):
            path = path_of(gaussians, given, frames)
            assert path.intrinsics.shape[:2] == (1, frames)
            asserts.cameras(path, SIZE)
            asserts.finite(path, f"the path of {frames} frames")
    for column in (3, 2):  # positions, directions
        coarse, fine = (
            path_of(gaussians, seen[5], frames).world_from_camera[0, :, :3, column].diff(dim=0).norm(dim=1).max()
            for frames in (60, 120)
        )
        assert fine <= 0.7 * coarse + 1e-4


def test_a_path_of_nerfstudios_viewer_is_where_the_scene_of_its_run_is(tmp_path):
    """Positions, directions and fields of view at their times, in OpenCV's axes; one pose that stands still, too."""
    eyes = torch.tensor([[0.0, 0, -1], [0.2, 0, -1], [0.5, -0.1, -0.8], [0.5, -0.1, -0.8]])
    poses = look_at(eyes, torch.zeros_like(eyes))
    flight = read_flight(path_file(tmp_path, poses))
    np.testing.assert_allclose(flight.times, [0, 0.1, 0.2, 0.3])
    path = along(flight, sphere(5), cameras(torch.eye(4)[None]), 7)
    torch.testing.assert_close(path.world_from_camera[0, ::2], poses, atol=1e-5, rtol=0)
    torch.testing.assert_close(path.intrinsics[0, :, 1, 1], torch.full((7,), 24 / math.tan(math.radians(30))))
    for changes, seconds in (({"fps": None}, 1.5), ({"fps": None, "seconds": None}, 0.125)):
        assert read_flight(path_file(tmp_path, poses, **changes)).times[-1] == pytest.approx(seconds)
    still = along(read_flight(path_file(tmp_path, poses[:1])), sphere(5), cameras(torch.eye(4)[None]), 3)
    torch.testing.assert_close(still.world_from_camera[0], poses[:1].expand(3, 4, 4), atol=1e-6, rtol=0)
    assert Film(VideoOptions(path=str(path_file(tmp_path, poses)), fps=30)).frames == 10
    assert Film(VideoOptions(path=str(path_file(tmp_path, poses[:1])))).frames == 72


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"camera_path": []}, "has no frames; add keyframes in the viewer"),
        ({"camera_type": "equirectangular"}, "of type 'equirectangular'; save one of type perspective"),
        ({"camera_path": [{"camera_to_world": [1.0] * 16, "fov": 50}]}, "is not a rotation and translation"),
        ({"camera_path": [{"camera_to_world": [1.0] * 12, "fov": 50}]}, "camera_to_world"),
        ({"fps": 0}, "fps"),
        ({"camera_path": None}, "camera_path"),
    ],
)
def test_a_file_that_is_no_path_is_a_line(changes, expected, tmp_path):
    with raises_line(UserError, match=expected, naming="path.json"):
        Film(VideoOptions(path=str(path_file(tmp_path, torch.eye(4)[None], **changes))))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("video.path=orbits", "video.path=orbits; give smooth, orbit or a .json .* Did you mean 'orbit'"),
        ("video.path=path.csv", "or a .json file of a camera path"),
        ("video.path=missing.json", "there is no camera path of nerfstudio missing.json"),
        ("video.turns=2", "video.turns=2 has no meaning with video.path=smooth"),
        ("video.path=orbit video.turns=0", "video.turns=0"),
        ("video.height=100000", "video.height=100000: expected 2 <= int <= 4320"),
        ("video.kind=stereo", "kind"),
    ],
)
def test_options_that_make_no_sense_are_a_line(words, expected):
    with raises_line(UserError, match=expected):
        Film(options(compose("stylize", words.split()), "video"))


def test_a_film_has_its_frames_and_stills_of_even_sides(tmp_path):
    styled = StyledScene((("red", sphere(50, torch.abs)),), cameras(torch.eye(4).repeat(4, 1, 1)), tuple("abcd"))
    for scale, height, size in ((0.5, None, (24, 32)), (1.0, 37, (36, 50))):
        film = Film(VideoOptions(frames=4, scale=scale, height=height, stills=2))
        assert film.size(styled.cameras) == size
        film.write(styled, tmp_path / "video.mp4", AutoRenderer())
        frames, stills = frames_of(tmp_path / "video.mp4"), sorted((tmp_path / "stills").iterdir())
        assert [frame.shape[:2] for frame in frames] == [size] * 4
        assert [still.name for still in stills] == ["frame_00001.jpg", "frame_00003.jpg"]
        with Image.open(stills[0]) as image:
            assert np.abs(np.asarray(image).astype(int) - frames[1]).mean() < 5
    with pytest.raises(UserError, match="a film needs the cameras of the scene"):
        film.write(StyledScene(styled.styles), tmp_path / "none.mp4", AutoRenderer())


def test_beyond_what_was_photographed_a_film_fades_to_the_background_unless_told_not_to(tmp_path, caplog):
    """A ball that was photographed from one side within 20 degrees, from a path around it."""
    ball = sphere(3000, lambda direction: 0.2 + 0 * direction)
    ball = replace(ball, means=0.4 * ball.means, scales=0.4 * ball.scales)

    def seen_from(*degrees):
        turn = torch.tensor(degrees, dtype=torch.float64).deg2rad()
        eyes = 2 * torch.stack([turn.sin(), torch.zeros_like(turn), -turn.cos()], dim=1)
        return look_at(eyes, torch.zeros_like(eyes))

    turns, known = (0, 5, 10, 20, 35, 40, 45, 60, 120, 180), 4
    scene = StyledScene((("", ball),), cameras(seen_from(0, 10, 20)), tuple("abc"))
    file = path_file(tmp_path, seen_from(*turns), 2 * math.degrees(math.atan(24 / 60)), fps=1)
    confidence = ViewConfidence.of(ball, scene.cameras)
    film, pictures = Film(VideoOptions(path=str(file), fps=1)), {}
    for fade, background in ((True, 1.0), (False, 1.0), (True, 0.0)):
        renderer = AutoRenderer(background=(background,) * 3)
        frames = film.images(ball, scene.cameras, confidence if fade else None, renderer)
        pictures[fade, background] = torch.stack(list(frames))
    faded, whole = pictures[True, 1.0], pictures[False, 1.0]
    assert (faded[:known] == whole[:known]).all() and (whole.amin((1, 2, 3)) < 0.3).all()
    ink = (1 - faded).mean((1, 2, 3))
    assert (ink[known - 1 : -3].diff() < 0).all() and (ink[-3:] == 0).all()
    assert (pictures[True, 0.0][-3:] == 0).all()
    shares = [float(confidence(cameras(pose[None])).mean()) for pose in seen_from(*turns)]
    (line,) = caplog.messages  # once, for the next one shows as much
    assert line.startswith(f"{sum(share < 0.5 for share in shares)} of 10 views of the film are mostly faded")
    last = {}
    for name, fade, photographed in (("faded", True, True), ("asked", False, True), ("chosen", True, False)):
        options = VideoOptions(path=str(file), fps=1, fade=fade)
        out = tmp_path / f"{name}.mp4"
        Film(options).write(replace(scene, photographed=photographed), out, AutoRenderer())
        last[name] = frames_of(out)[-1].min()
    assert last["faded"] > 230 and max(last["asked"], last["chosen"]) < 80


def test_the_command_writes_a_folder_or_the_file_that_it_is_told(tmp_path, capsys):
    inputs.gaussians(1, 20).save(tmp_path / "scene.ply")
    poses = [{"file_path": f"{i}.png", "transform_matrix": torch.eye(4).tolist()} for i in range(2)]
    content = {"w": 64, "h": 48, "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "frames": poses}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    for out, film in (("made", "made/video.mp4"), ("new/a.mp4", "new/a.mp4")):
        command.main([str(tmp_path / "scene.ply"), "--out", str(tmp_path / out), "video.frames=2", "video.height=48"])
        told = capsys.readouterr()
        assert told.out.strip().endswith(film) and told.err == "film of 2 frames of 64 x 48, 24 a second …\n"
        assert len(frames_of(tmp_path / film)) == 2
    empty = f"splat.folder={tmp_path / 'made'}"  # of cameras, which are chosen then, as they are for styles
    command.main([str(tmp_path / "scene.ply"), "--out", str(tmp_path / "b.mp4"), "video.frames=2", empty])
    assert len(frames_of(tmp_path / "b.mp4")) == 2
