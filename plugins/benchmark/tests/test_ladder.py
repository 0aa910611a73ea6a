"""Ladders: distortions against closed forms, counts on figures of known order, the command on rungs that exist."""

import csv
import dataclasses
import json
import tomllib
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.stats import kendalltau

from anystyle.errors import UserError
from anystyle.geometry.harmonics import CONSTANT, constant_from_rgb
from anystyle.io.atomic import write_json
from anystyle.registry.catalog import catalog
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians
from anystyle_benchmark import distortions, ladder
from anystyle_benchmark import judge as judging
from anystyle_benchmark.command_ladder import main, rungs
from anystyle_benchmark.distortions import DISTORTIONS, RANDOM, Shot
from anystyle_benchmark.ladder import LADDER, STEPS, Verdict, expectations, rung, verdict
from anystyle_benchmark.results import Cell, Interval, Record
from anystyle_benchmark.spec import read_spec
from anystyle_benchmark.track import TRACKS, Inputs
from tests.support.benchmark_world import write_track
from tests.support.pictures import save

SIZE = (24, 32)


@pytest.fixture(scope="module")
def shot():
    """Gaussians in a slab, seen by three cameras; the unstyled scene has other colours."""
    generator = torch.Generator().manual_seed(0)
    count, views = 400, 3
    draws = torch.rand(count, 10, generator=generator)
    means = (draws[:, :3] - 0.5) * torch.tensor([5.0, 4.0, 1.0]) + torch.tensor([0.0, 0.0, 4.0])
    gaussians = Gaussians(
        means=means[None],
        rotations=torch.randn(1, count, 4, generator=generator),
        scales=(0.05 + 0.1 * draws[:, 3:6])[None],
        opacities=(0.3 + 0.5 * draws[:, 6])[None],
        harmonics=constant_from_rgb(0.2 + 0.6 * draws[:, 7:])[None, :, None],
    )
    harmonics = constant_from_rgb(0.2 + 0.6 * torch.rand(1, count, 1, 3, generator=generator))
    unstyled = dataclasses.replace(gaussians, harmonics=harmonics)
    poses = torch.eye(4).repeat(1, views, 1, 1)
    poses[0, :, 0, 3] = torch.tensor([-0.4, 0.0, 0.4])
    intrinsics = torch.tensor([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]]).repeat(1, views, 1, 1)
    renderer = TorchRenderer()
    return Shot(gaussians, unstyled, Cameras(poses, intrinsics, SIZE), lambda g, c: renderer(g, c).color[0])


def projected(cameras, view, points):
    """Which points N 3 lie in an image, and the depths of all."""
    pose = cameras.camera_from_world[0, view]
    x, y, z = cameras.intrinsics[0, view] @ (pose[:3, :3] @ points.mT + pose[:3, 3:])
    pixels = torch.stack([x / z, y / z], -1)
    return (pixels >= 0).all(-1) & (pixels < torch.tensor([32, 24])).all(-1), z


@pytest.mark.parametrize("name", DISTORTIONS)
def test_strength_0_is_the_identity_and_each_rung_is_further_away(shot, name):
    one, render = DISTORTIONS[name], shot.render
    shot = dataclasses.replace(shot, render=lambda g, c: F.interpolate(render(g, c), scale_factor=6, mode="bilinear"))
    assert torch.equal(one.apply(shot, 0.0), shot.views)
    rows = [one.apply(shot, strength) for strength in one.strengths]
    assert all(row.shape == shot.views.shape and row.min() >= 0 and row.max() <= 1 for row in rows)
    gaps = [float((row - shot.views).abs().mean()) for row in rows]
    assert 0 < gaps[0] < gaps[1] < gaps[2] < gaps[3]
    assert torch.equal(one.apply(shot, one.strengths[1]), rows[1])  # nothing is drawn anew
    drawn = one.apply(dataclasses.replace(shot, seed=1), one.strengths[1])
    assert torch.equal(drawn, rows[1]) == (name not in RANDOM)


def test_blur_is_that_of_scipy(shot):
    share = 0.07
    sigma = share * SIZE[0]
    expected = gaussian_filter(
        shot.views.numpy(), (0, 0, sigma, sigma), mode="nearest", truncate=round(4 * sigma) / sigma
    )
    assert distortions.blurred(shot.views, share).numpy() == pytest.approx(expected, abs=1e-5)


def test_noise_has_the_standard_deviation_that_is_asked_for(shot):
    flat = torch.full((3, 3, 200, 200), 0.5)
    noise = distortions.noisy(flat, 0.1) - flat
    assert noise.std() == pytest.approx(0.1, rel=0.01) and not torch.equal(noise[0], noise[1])
    changed = distortions.recolored(shot.gaussians, 0.2)
    assert ((changed.harmonics - shot.gaussians.harmonics) * CONSTANT).std() == pytest.approx(0.2, rel=0.05)
    assert changed.means is shot.gaussians.means


def test_gaussians_move_by_pixels_of_the_nearest_camera(shot):
    share = 0.01
    offset = (distortions.moved(shot.gaussians, shot.cameras, share).means - shot.gaussians.means)[0]
    still = (offset == 0).all(-1)
    pixels = []
    for view in range(3):
        seen, z = projected(shot.cameras, view, shot.gaussians.means[0])
        pixels.append(torch.where(seen, offset[:, 0] * 30 / z, torch.nan))
    pixels = torch.stack(pixels)
    assert torch.equal(still, pixels.isnan().all(0))  # what no view shows stays
    assert still.any() and np.nanstd(pixels.numpy()) == pytest.approx(share * 24, rel=0.1)


def test_floaters_are_in_free_space_in_view_and_fewer_are_part_of_more(shot):
    count = shot.gaussians.means.shape[1]
    few, many = (distortions.with_floaters(shot.gaussians, shot.cameras, n) for n in (2, 6))
    assert torch.equal(few.means[:, :count], shot.gaussians.means) and few.means.shape[1] == count + 6
    few, many = few.means[0, count:].reshape(3, 2, 3), many.means[0, count:].reshape(3, 6, 3)
    nearest = float(shot.gaussians.means[0, :, 2].min())
    for view in range(3):
        seen, z = projected(shot.cameras, view, many[view])
        assert seen.all() and (z > 0).all() and (z < nearest).all()
        assert all((many[view] - one).norm(dim=-1).min() < 1e-5 for one in few[view])
    again = distortions.with_floaters(shot.gaussians, shot.cameras, 6)
    radius = again.scales[0, count:, 0].reshape(3, 6)
    _, z = projected(shot.cameras, 1, many[1])
    assert radius[1] * 30 / z == pytest.approx(torch.full((6,), distortions.FLOATER_RADIUS * 24), rel=1e-4)


def test_wrong_cameras_turn_and_move_by_a_share_of_the_view(shot):
    share = 0.05
    wrong = distortions.misplaced(shot.cameras, shot.gaussians, share)
    before, after = shot.cameras.world_from_camera[0], wrong.world_from_camera[0]
    turned = before[:, :3, :3].mT @ after[:, :3, :3]
    assert turned @ turned.mT == pytest.approx(torch.eye(3).expand(3, 3, 3), abs=1e-6)
    axis = turned.mT[..., 2]  # the old optical axis, in the new camera
    assert (axis[:, :2] / axis[:, 2:]).norm(dim=-1) * 30 == pytest.approx(torch.full((3,), share * 24), rel=1e-4)
    step = (before[:, :3, :3].mT @ (after - before)[:, :3, 3:])[..., 0]
    assert step[:, 2] == pytest.approx(torch.zeros(3), abs=1e-6)
    for view in range(3):
        seen, z = projected(shot.cameras, view, shot.gaussians.means[0])
        assert step[view].norm() * 30 / z[seen].median() == pytest.approx(share * 24, rel=1e-4)
    assert (step[:, :2] / step[:, :2].norm(dim=-1, keepdim=True)).std(0).min() > 0.1  # each its own way


def test_casts_are_gains_and_flicker_differs_between_views(shot):
    dark = shot.views * 0.3
    gains = distortions.tinted(dark, 0.2) / dark
    assert gains == pytest.approx(torch.tensor([0.9, 1.2, 0.9])[:, None, None].expand_as(gains), rel=1e-5)
    gains = (distortions.flickering(dark, 0.1) / dark).flatten(2)
    assert gains.std(-1).max() < 1e-5 and gains.mean(-1).std(0).min() > 0.01


def test_a_style_taken_back_is_the_render_of_colours_between(shot):
    harmonics = torch.lerp(shot.gaussians.harmonics, shot.unstyled.harmonics, 0.25)
    between = shot.render(dataclasses.replace(shot.gaussians, harmonics=harmonics), shot.cameras)
    assert distortions.faded(shot, 0.25) == pytest.approx(between, abs=1e-5)
    assert torch.equal(distortions.faded(shot, 1.0), shot.unstyled_views)


def made(rows, figure="fid", distortion="view_blur", better="lower"):
    """The verdict on values by rung, in 4 scenes x 4 styles that differ a little."""
    values = np.asarray(rows, float)[:, None, None] + 1e-3 * np.random.default_rng(0).normal(size=(1, 4, 4))
    return verdict(figure, distortion, values if better == "lower" else -values)


def test_steps_in_order_are_counted():
    one = made([1, 2, 3, 4, 5])
    assert (one.ordered, one.tau) == (Interval(4, 4, 4, 16), Interval(1, 1, 1, 16))
    assert one.words == "orders"
    assert made([5, 4, 3, 2, 1], better="higher").words == "orders"  # less is worse
    one = made([1, 2, 2, 3, 2.5])
    assert (one.ordered.mean, one.tau.mean, one.words) == (2, pytest.approx(0.7), "orders in part")
    one = made([1, np.nan, 3, 4, 5])
    assert (one.ordered.mean, one.tau.mean) == (2, 1)
    assert made([5, 4, 3, 2, 1]).words == "inverted (fails)"
    assert made([3, 3, 3, 3, 3]).words == "blind (fails)"
    one = made([1, 2, np.inf, np.inf, np.inf])
    assert one.ordered.mean == 2


@pytest.mark.parametrize(
    ("figure", "distortion", "expected", "words"),
    [
        ("fid", "view_blur", "worse", ("orders", "blind (fails)", "inverted (fails)")),
        ("st_lpips", "fade", "better", ("inverted (fails)", "blind (fails)", "rewards it (by design)")),
        ("fid", "cameras", "blind", ("sees it (unforeseen)", "blind (by design)", "rewards it (unforeseen)")),
        ("psnr", "fade", None, ("worse (no claim)", "blind (no claim)", "better (no claim)")),
    ],
)
def test_a_finding_stands_beside_what_is_expected(figure, distortion, expected, words):
    found = [made(rows, figure, distortion) for rows in ([1, 2, 3, 4, 5], [1] * 5, [5, 4, 3, 2, 1])]
    assert [one.expected for one in found] == [expected] * 3
    assert tuple(one.words for one in found) == words
    assert found[2].ordered.mean == (4 if expected == "better" else 0)


def test_tau_is_that_of_scipy_and_few_or_contrary_cells_decide_nothing():
    values = np.random.default_rng(1).normal(size=(5, 4, 6))
    one = verdict("fid", "view_blur", values)
    taus = [kendalltau(range(5), column).statistic for column in values.reshape(5, -1).T]
    assert one.tau.mean == pytest.approx(np.mean(taus), rel=1e-6)
    assert made([1, 2, 3, 4, 5]).found == "worse"
    assert verdict("fid", "view_blur", values[:, :1]).words == "undecided"  # of one scene
    contrary = np.arange(5.0)[:, None, None] * np.array([1, 1, -1, 1])[:, None] + np.zeros(3)
    assert verdict("fid", "view_blur", contrary).words == "undecided"


def test_noise_is_rarely_said_to_be_ordered():
    """Of figures without any order, with as much between scenes as between cells, 5 % may seem to have one."""
    random = np.random.default_rng(2)
    seen = 0
    for _ in range(40):
        values = random.normal(size=(5, 4, 1)) + random.normal(size=(5, 4, 4))
        seen += verdict("fid", "view_blur", values).found in ("worse", "better")
    assert seen <= 7  # at 5 % more than 7 of 40 are as likely as 0.1 %


def test_every_metric_of_the_tracks_has_an_expectation_with_a_reason():
    named = {figure for figure, _ in expectations()}
    known = {figure for name in catalog().names("metric") for figure in catalog().find("metric", name).load().better}
    ours = {"st_lpips", "warp_st_lpips_short", "warp_st_lpips_long"}  # figures of networks that stand in
    assert named <= known | ours
    metrics = {
        name
        for path in TRACKS.glob("*/track.toml")
        for names in Inputs(str(path)).track.metrics.values()
        for name in names
    }
    for name in metrics:
        assert named & {*catalog().find("metric", name).load().better}, f"nothing is expected of {name}"
    assert all(row.reason.endswith(".") for row in expectations().values())
    assert {distortion for _, distortion in expectations()} == {*DISTORTIONS}
    path = Path(ladder.__file__).with_name("ladder.toml")
    rows = tomllib.loads(path.read_text())["expected"]
    assert sum(len(row["figures"]) * len(row["distortions"]) for row in rows) == len(expectations())  # each once


@pytest.fixture(scope="module")
def made_rungs(tmp_path_factory):
    """A small track, and a folder with photographs on the rungs of blur and of noise, as if a method had left them."""
    folder = tmp_path_factory.mktemp("rungs")
    metrics = {"image": ["color_match", "psnr", "kid"]}
    track = write_track(folder / "track", scenes=2, views=2, images=2, texts=0, metrics=metrics)
    inputs, results = Inputs(str(track)), folder / "results"
    spec, _ = read_spec("branch")
    # Of views as small as these a blur is seen when it is wider.
    functions = {
        "view_blur": lambda views, share: distortions.blurred(views, 8 * share),
        "view_noise": distortions.noisy,
    }
    for scene in inputs.track.scenes:
        files = inputs.photographs(scene)
        photographs = [Image.open(files[view]).resize((64, 48)) for view in scene.views]
        views = torch.stack([torch.tensor(np.asarray(one)).permute(2, 0, 1) / 255 for one in photographs])
        for style in inputs.track.styles:
            for name, function in functions.items():
                for index, strength in enumerate((0.0, *DISTORTIONS[name].strengths)):
                    cell = Cell(rung(name, index), 0, scene.name, style.name)
                    for view, image in zip(scene.views, function(views, strength), strict=True):
                        pixels = (255 * image).round().byte().permute(1, 2, 0).numpy()
                        save(cell.images(results) / f"{view}.png", pixels)
                    write_json(cell.record(results), msgspec.to_builtins(Record("done")))
    words = [str(results), "--track", str(track), "--distortions", ",".join(functions), "--processes", "1"]
    main(words)
    made = rungs(spec, [*functions], {"image"}, seeds=3)
    assert [(one.name, one.seeds) for one in made[:6:5]] == [("undistorted", 1), ("view_noise-1", 3)]
    return track, results, words


def test_the_command_counts_and_writes_tables(made_rungs, monkeypatch, capsys):
    _, results, words = made_rungs
    verdicts = json.loads((results / LADDER).read_text())["verdicts"]
    found = {(one.figure, one.distortion): one for one in msgspec.convert(verdicts, list[Verdict])}
    assert found["psnr", "view_blur"].ordered == Interval(4, 4, 4, 4)
    assert found["psnr", "view_blur"].words == "worse (no claim)"
    assert found["color_match", "view_noise"].expected == "worse"
    assert found["kid", "view_noise"].tau.n == 2  # a distance of all styles of a scene
    before = {path: path.read_bytes() for path in results.glob("*.*") if path.is_file()}
    capsys.readouterr()
    monkeypatch.setattr(judging.loop, "judge_scene", None)  # nothing is judged again
    main(words)
    assert {path: path.read_bytes() for path in before} == before
    told = capsys.readouterr()
    assert "judge 18/18" in told.err and (results / "ladder.md").read_text() in told.out
    rows = {row["score"]: row for row in csv.DictReader((results / "ladder.csv").read_text().splitlines())}
    assert rows["psnr ↑"]["views: blur"] == "4 worse (no claim)"
    assert "kid: " in told.out and "stand-in" in told.out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--method", "photographs"], "not a preset of anystyle stylize"),
        (["--method", "nobody"], "no method is named 'nobody'"),
        (["--distortions", "view_blur,fog"], "no distortion is named 'fog'"),
        (["--scenes", "moon"], "no scene is named 'moon'"),
        (["--metrics", "beauty"], "metric of track"),
    ],
)
def test_what_is_wrong_is_a_line(words, line, tmp_path):
    with pytest.raises(UserError, match=line):
        main([str(tmp_path / "new"), "--track", "smoke", *words])
    assert not (tmp_path / "new").exists()


def test_rungs_of_another_method_are_refused(made_rungs):
    with pytest.raises(UserError, match="rungs of another method"):
        main([*made_rungs[2], "--method", "brush"])


@pytest.mark.slow
def test_a_real_ladder(tmp_path):
    words = ["--track", "smoke", "--distortions", "fade,floaters", "--metrics", "color_match,structure_distance"]
    main([str(tmp_path / "ladder"), *words])
    verdicts = json.loads((tmp_path / "ladder" / LADDER).read_text())["verdicts"]
    found = {(one.figure, one.distortion): one for one in msgspec.convert(verdicts, list[Verdict])}
    assert found.keys() == {*product(("color_match", "structure_distance"), ("fade", "floaters"))}
    color = found["color_match", "fade"]
    assert color.ordered.mean > 3 and color.tau.n == 4
    assert STEPS == 4
