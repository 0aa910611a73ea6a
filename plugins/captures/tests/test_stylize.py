"""Photographs in: cameras found, a scene fitted, styles as its colours; and captures that cannot work."""

import json

import pytest
import torch

import anystyle
from anystyle import PoseOptions, ViewOptions
from anystyle.pipeline.encode import encoder
from anystyle.types import Views
from anystyle_captures.fit import Fit
from tests.support.cards import World, arc
from tests.support.known_scene import photographed_wall
from tests.support.pictures import save
from tests.support.real_data import real

FOCAL, SIZE = 200.0, (168, 192)
SHORT = Fit(quality="draft", num_gaussians=1500, num_steps=60, holdout=4)
WHOLE = Fit(quality="draft", num_gaussians=1500, num_steps=80, holdout=0, keep=False)
QUICK = {"quality": "draft", "num_gaussians": 800, "num_steps": 20}
VIEWS, VIDEO = ViewOptions(short_side=84), {"frames": 2, "scale": 0.5}


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load("painter")


def write(folder, poses):
    for number, pose in enumerate(poses):
        save(folder / f"view{number}.png", World(0).picture(pose, FOCAL, SIZE))
    return folder


@pytest.fixture(scope="module")
def orbit(tmp_path_factory):
    return write(tmp_path_factory.mktemp("capture") / "orbit", arc(6, 40))


@pytest.fixture(scope="module")
def fitted(orbit, stylizer):
    """Results of two styles in one fitted scene."""
    pictures = [torch.rand(3, 32, 32, generator=torch.Generator().manual_seed(seed)) for seed in (1, 2)]
    pictures[1] = pictures[1] * torch.tensor([1.0, 0.2, 0.1])[:, None, None]
    return anystyle.stylize(
        orbit, pictures, model=stylizer, poses=PoseOptions("auto"), reconstruction=SHORT, views=VIEWS, video=VIDEO
    )


def test_photographs_become_a_scene_that_styles_color(fitted, tmp_path):
    first, second = fitted[0], fitted[1]
    assert torch.equal(first.gaussians.means, second.gaussians.means)
    assert (first.gaussians.harmonics - second.gaussians.harmonics).abs().mean() > 0.05
    unstyled = torch.stack(list(fitted.encoded.render(fitted.run.unstyled)))
    error = (unstyled - fitted.encoded.views.images[0]).square().mean((1, 2, 3))
    assert float((-10 * error.log10()).mean()) > 20
    anystyle.save(first, tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())["reconstruction"]
    assert report["kind"] == "fit" and report["registered"] == 6 and report["trust"] == "good"
    assert report["reasons"] == [] and report["num_gaussians"] == first.gaussians.means.shape[1]
    assert report["heldout_psnr"] > 15 and 0 < report["heldout_ssim"] < 1 and report["seconds"] > 0


def test_known_cameras_are_kept(stylizer):
    images, cameras, _ = photographed_wall(num_views=5)
    images = torch.nn.functional.interpolate(images, size=(42, 56), mode="bilinear")
    views = Views(images[None], cameras.resized((42, 56)))
    results = anystyle.stylize(
        views, torch.rand(3, 32, 32), model=stylizer, poses=PoseOptions("known"), reconstruction=Fit(**QUICK, holdout=0)
    )
    torch.testing.assert_close(results[0].cameras.world_from_camera, cameras.world_from_camera)
    assert "heldout_psnr" not in results[0].report["reconstruction"]


@pytest.mark.slow
def test_a_branch_inside_of_the_network_colors_a_fitted_scene(orbit):
    """Its pixels come from the backbone's features of the same views."""
    results = anystyle.stylize(
        orbit, "red dots", model="tiny", poses=PoseOptions("sfm"), reconstruction=Fit(**QUICK), views=VIEWS
    )
    unstyled = results.run.unstyled
    styled = results[0].gaussians
    assert torch.equal(styled.means, unstyled.means) and not torch.equal(styled.harmonics, unstyled.harmonics)


def test_found_cameras_serve_the_backbone_too(stylizer):
    frames = sorted(real("scenes/train/images").iterdir())[:4]
    results = anystyle.stylize(
        frames, torch.rand(3, 32, 32), model=stylizer, poses=PoseOptions("sfm"), reconstruction="feedforward"
    )
    report = results[0].report["reconstruction"]
    assert report["kind"] == "feedforward" and report["registered"] == 4 and report["trust"] == "good"


def walked_through(images):
    """Photographs with a grey figure that stands elsewhere in each."""
    images = images.clone()
    height, width = images.shape[-2:]
    for view, image in enumerate(images):
        left = 4 + view * (width - 16) // len(images)
        image[:, height // 4 : -height // 8, left : left + 10] = 0.1 if view % 2 else 0.9
    return images


@pytest.mark.parametrize("moves", [False, True])
def test_a_moving_figure_is_reported(stylizer, caplog, moves):
    images, cameras, _ = photographed_wall(num_views=5)
    images = torch.nn.functional.interpolate(images, size=(84, 112), mode="bilinear")
    views = Views(walked_through(images)[None] if moves else images[None], cameras.resized((84, 112)))
    WHOLE(views, encoder(stylizer), stylizer.renderer)
    assert ("something moved while they were taken" in caplog.text) is moves


def test_a_photograph_of_something_else_is_named(stylizer, caplog):
    images, cameras, _ = photographed_wall(num_views=6)
    images = torch.nn.functional.interpolate(images, size=(84, 112), mode="bilinear")
    images[4, :, 20:64, 30:80] = 0.0
    views = Views(images[None], cameras.resized((84, 112)), names=tuple(f"photo_{view}" for view in range(6)))
    WHOLE(views, encoder(stylizer), stylizer.renderer)
    (line,) = [record.message for record in caplog.records if "differs in a large part" in record.message]
    assert "photo_4 (" in line and "photo_3" not in line and "leave them out or mask it" in line


def test_a_capture_that_cannot_work_ends_in_a_plain_sentence(tmp_path, stylizer, caplog):
    photos, style = write(tmp_path / "photos", arc(2, 10)), torch.rand(3, 32, 32)
    results = anystyle.stylize(photos, style, model=stylizer, poses=PoseOptions("auto"), views=VIEWS)
    reason = "2 photographs are too few"
    assert reason in caplog.text and "what the backbone predicts in a single pass" in caplog.text
    report = results[0].report["reconstruction"]
    assert report["kind"] == "feedforward" and report["trust"] == "failed" and reason in report["reasons"][0]


def test_a_fit_without_cameras_is_refused(stylizer):
    images, _, _ = photographed_wall(num_views=3)
    views = Views(torch.nn.functional.interpolate(images, size=(42, 56))[None])
    with pytest.raises(ValueError, match="poses=sfm finds cameras"):
        SHORT(views, stylizer.encode, stylizer.renderer)
