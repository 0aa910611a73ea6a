"""360° photographs: the views that they are cut into, which photographs are some, and their cameras and scenes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import zoom
from scipy.spatial.transform import Rotation

from anystyle.contracts import PosedViews
from anystyle.data.folder import read_originals
from anystyle.data.images import open_image
from anystyle.geometry.transforms import similarity_of_cameras
from anystyle.io.video import write_video
from anystyle.types import Original, no_progress
from anystyle_captures.fit import fit_photographs
from anystyle_captures.fit_loop import FitOptions
from anystyle_captures.panorama import Cut, closes, cut_of
from anystyle_captures.sfm.model import Photograph, SearchOptions
from anystyle_captures.sfm.trust import agreement
from anystyle_captures.stereo import _neighbors
from anystyle_captures.structure_from_motion import StructureFromMotion, find_cameras
from anystyle_captures.twins import held_out
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.real_data import real

BOX = np.array([2.0, 1.3, 2.5])
GRIDS = [np.random.default_rng(n).random((n, n, n, 3)) for n in (4, 8, 16, 32, 64)]
PAINT = np.mean([zoom(grid, (*[64 // len(grid)] * 3, 1), order=0) for grid in GRIDS], axis=0)


def room(rays, center):
    """8-bit colours that unit rays see from a place in a box whose walls show random cells of several sizes."""
    reach = (np.sign(rays) * BOX - center) / np.where(rays == 0, 1e-9, rays)
    at = (center + reach.min(-1, keepdims=True) * rays) / (2 * BOX) + 0.5
    color = PAINT[tuple((64 * at).astype(int).clip(0, 63).transpose(2, 0, 1))]
    return np.clip(255 * (0.5 + 2.2 * (color - 0.5)), 0, 255).round().astype(np.uint8)


def sphere(width, color, samples=1):
    """A panorama of the colours of unit rays, by the definition: longitudes across, latitudes down."""
    turn = (np.arange(width * samples) + 0.5) * 2 * np.pi / (width * samples)
    longitude, latitude = np.meshgrid(turn - np.pi, np.pi / 2 - turn[: len(turn) // 2])
    rays = np.cos(latitude) * np.stack([np.sin(longitude), -np.tan(latitude), np.cos(longitude)])
    return averaged(color(rays.transpose(1, 2, 0)), samples)


def averaged(pixels, samples):
    shape = pixels.shape[0] // samples, samples, pixels.shape[1] // samples, samples, 3
    return Image.fromarray(pixels.reshape(shape).mean((1, 3)).round().astype(np.uint8))


def rays_of(cut, rotation, side):
    """Unit rays of a view's pixels, turned."""
    grid = (2 * (np.arange(side) + 0.5) / side - 1) * cut.slope
    rays = np.stack([*np.meshgrid(grid, grid), np.ones((side, side))], -1) @ rotation.T
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


@pytest.mark.parametrize("around", [4, 6, 9])
def test_views_show_what_lies_in_their_direction_and_leave_no_gap(around):
    """Colours are directions; half a pixel is 2.9 levels here, at the seam and the pole as everywhere."""
    cut, rays = Cut(around), Rotation.random(9999, random_state=0).as_matrix()[:, 0]
    panorama, seen = sphere(128, lambda rays: (127.5 + 120 * rays).round()), np.zeros(len(rays), bool)
    for view, rotation in enumerate(cut.panorama_from_view):
        shown = np.asarray(cut.view(view, panorama)).astype(float)
        exact = 127.5 + 120 * rays_of(cut, rotation, cut.side(128))
        assert abs(shown - exact).max() < 1.6 and abs((shown - exact).mean()) < 0.05
        x, y, z = (rays @ rotation).T
        seen |= np.maximum(abs(x), abs(y)) <= cut.slope * z
    assert seen[rays[:, 1] < np.sin(np.radians(90 - cut.degrees / 2))].all() and not seen[rays[:, 1] > 0.8].any()


def test_no_photograph_or_painting_is_taken_for_a_panorama():
    """Nor are parts of them that are twice as wide as high."""
    files = [path for folder in ("captures", "photos", "paintings", "styles") for path in real(folder).rglob("*.jpg")]
    for path in files:
        whole = open_image(path, longest=1024)
        width, height = min(whole.width, 2 * whole.height), min(whole.height, whole.width // 2)
        corner = whole.crop((whole.width - width, whole.height - height, *whole.size))
        assert not any(map(closes, (whole, whole.crop((0, 0, width, height)), corner))), path


def test_the_kind_of_most_photographs_is_read(tmp_path, caplog):
    around, plain = sphere(512, lambda rays: room(rays, np.array([0.4, 0.2, -0.3]))), Image.new("RGB", (512, 256))
    pictures = [around, around, around.crop((9, 9, 409, 209)), plain, plain.resize((64, 64))]
    shots = [Original(f"p{at}", None, one.size[::-1], one, Image.Exif()) for at, one in enumerate(pictures)]
    xmp = b'<x xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="equirectangular"/>'
    plain.save(tmp_path / "tagged.jpg", xmp=xmp)
    tagged = read_originals([tmp_path], longest=64, max_views=4)
    assert cut_of([*shots, *tagged]) == (Cut(6), [*shots[:4], *tagged]) and "left out: p4" in caplog.text
    assert "5 panoramas are cut into 35 views of up to 175 x 175 pixels, 94° each" in caplog.text
    assert cut_of(shots[1:])[0] is None and cut_of([one._replace(panorama=0) for one in shots[:2]])[0] is None
    assert cut_of([shots[3]._replace(panorama=8)])[0] == Cut(8)
    with pytest.raises(ValueError, match="cut into 4 to 24 views"):
        cut_of([shots[3]._replace(panorama=3)])
    with pytest.raises(ValueError, match="panorama=8: no photograph is twice as wide as high"):
        cut_of([shots[4]._replace(panorama=8)])


@pytest.fixture(scope="module")
def walk():
    """Poses of panoramas, and the panoramas."""
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = [[-0.8, 0.1, 0], [-0.4, 0, 0.3], [0, 0.1, -0.2], [0.4, -0.1, 0.3], [0.8, 0, 0]]
    poses[:, :3, :3] = Rotation.from_rotvec(np.random.default_rng(0).normal(0, 0.2, (5, 3))).as_matrix()
    return poses, [sphere(640, lambda rays, pose=pose: room(rays @ pose[:3, :3].T, pose[:3, 3]), 2) for pose in poses]


def test_panoramas_are_found_as_rigs(walk):
    poses, panoramas = walk[0][:4], walk[1][:4]
    shots = [Photograph(f"p{index}", np.array(picture), cut=Cut(4)) for index, picture in enumerate(panoramas)]
    found = find_cameras(shots, searches=(SearchOptions(min_side=192, max_side=192, num_features=500),))
    assert found.verdict.trust == "good" and found.model.registered.all()
    difference = agreement(found.model.world_from_camera, poses)
    assert difference.rotation.max() < 0.3 and difference.position.max() < 0.02
    np.testing.assert_allclose(found.model.lenses, [[Cut(4).focal(242), 121, 121, 0]] * 4)  # as known, exactly


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_film_of_panoramas_fits_as_well_as_pinhole_pictures_from_known_places(walk, tmp_path):
    """Within 0.3 dB, of a panorama that is held out."""
    poses, panoramas = walk
    frames = [torch.from_numpy(np.array(picture)).permute(2, 0, 1) / 255 for picture in panoramas]
    write_video(frames, tmp_path / "walk.mp4", fps=2)
    originals = read_originals([tmp_path / "walk.mp4"], longest=640, max_views=5)
    size = {"short_side": 112, "multiple": 14, "enlarge": False}
    posed = StructureFromMotion(keep=False)(originals, **size, on_progress=no_progress)
    assert isinstance(posed, PosedViews) and posed.verdict.trust == "good"
    cut, cameras, images = Cut(6), posed.views.cameras, posed.views.images[0]
    assert len(images) == 35 and posed.views.names[3].endswith("_up")
    torch.testing.assert_close(cameras.intrinsics[0, 7].double(), torch.from_numpy(cut.intrinsics(112)))
    known = np.tile(np.eye(4), (5, 7, 1, 1))
    known[..., :3, :3] = cut.panorama_from_view
    known = (poses[:, None] @ known).reshape(-1, 4, 4)
    difference = agreement(cameras.world_from_camera[0].double().numpy(), known)
    assert difference.rotation.max() < 0.1 and difference.position.max() < 0.01
    # Stereo sees none in two of one place.
    for view, others in enumerate(_neighbors(cameras.map(torch.Tensor.double), posed.points)):
        assert others and all(other // 7 != view // 7 for other in others)
    exact = [averaged(room(rays_of(cut, pose[:3, :3], 448), pose[:3, 3]), 4) for pose in known]
    exact = torch.stack([torch.from_numpy(np.array(picture)).permute(2, 0, 1) / 255 for picture in exact])
    placed = similarity_of_cameras(torch.from_numpy(known), cameras.world_from_camera[0].double())
    truth = replace(cameras, world_from_camera=placed.poses(torch.from_numpy(known)).float()[None])
    options = {"num_gaussians": 6000, "options": FitOptions(num_steps=350, final_steps=0)}
    options |= {"heldout": held_out([[view] for view in range(35)], 5, cameras), "points": posed.points}
    assert options["heldout"] == tuple(range(14, 21))
    given = (images, cameras), (exact, truth)
    psnr = [fit_photographs(*one, CpuRenderer(), **options).heldout.psnr for one in given]
    assert psnr[0] > psnr[1] - 0.3 and psnr[1] > 17, psnr
