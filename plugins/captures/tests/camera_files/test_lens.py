"""Distortion against COLMAP's models, and photographs without it."""

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.poses import stored_cameras
from anystyle_captures.camera_files import colmap as colmap_files
from anystyle_captures.camera_files.lens import Lens

SIZE = (480, 640)
BROWN = Lens(SIZE, (520.0, 510.0), (322.0, 236.0), (-0.12, 0.03, 0.0, 0.0), (0.002, -0.003))
WIDE = Lens(SIZE, (300.0, 300.0), (320.0, 240.0), (0.02, -0.01, 0.003, -0.0005), fisheye=True)
ROUND = Lens(SIZE, (500.0, 500.0), (318.0, 243.0), (0.15, -0.05, 0.01, -0.002), (-0.001, 0.002))
BARREL = Lens(SIZE, (530.0, 530.0), (320.0, 240.0), (-0.25, 0.0, 0.0, 0.0))


def rays(number=200, reach=0.6):
    points = torch.rand(number, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return reach * (2 * points - 1)


@pytest.mark.parametrize(
    ("model", "lens", "terms"),
    [
        ("OPENCV", BROWN, [*BROWN.radial[:2], *BROWN.tangential]),
        ("FULL_OPENCV", BROWN, [*BROWN.radial[:2], *BROWN.tangential, 0, 0, 0, 0]),
        ("OPENCV_FISHEYE", WIDE, WIDE.radial),
    ],
)
def test_rays_are_seen_where_colmap_sees_them(model, lens, terms):
    pycolmap = pytest.importorskip("pycolmap")
    camera = pycolmap.Camera(model=model, width=640, height=480, params=[*lens.focal, *lens.center, *terms])
    points = rays()
    seen = camera.img_from_cam(np.column_stack([points.numpy(), np.ones(len(points))]))
    np.testing.assert_allclose(lens.pixels(points).numpy(), seen, atol=1e-9)


@pytest.mark.parametrize("lens", [BROWN, WIDE, ROUND, BARREL])
def test_a_photograph_is_undistorted_and_filled(lens):
    """Of a photograph whose colours are the rays of its pixels, the undistorted one shows a pinhole camera's."""
    undistortion = lens.undistortion()
    grid = lens._grid(241)
    border = torch.cat([grid[0], grid[-1], grid[:, 0], grid[:, -1]]).numpy()
    directions = (border - undistortion.intrinsics[:2, 2]) / undistortion.intrinsics[[0, 1], [0, 1]]
    seen = lens.pixels(torch.from_numpy(directions)).numpy()
    assert seen.min() > -0.01 and (seen < np.array([640, 480]) + 0.01).all()  # nothing is invented
    assert np.minimum(seen, np.array([640, 480]) - seen).min(axis=1).min() < 2  # and no more is cut than must be

    # Newton's method inverts the lens, pixel by pixel of a copy of a quarter of the size.
    v, u = torch.meshgrid(torch.arange(120) + 0.5, torch.arange(160) + 0.5, indexing="ij")
    pixels = 4 * torch.stack([u, v], -1).double().reshape(-1, 2)
    found = (pixels - pixels.new_tensor(lens.center)) / pixels.new_tensor(lens.focal)
    for _ in range(30):
        found = found - (lens.pixels(found) - pixels) / pixels.new_tensor(lens.focal)
    colours = (127.5 + 100 * found).clamp(0, 255).round().byte().reshape(120, 160, 2).numpy()
    picture = undistortion.apply(Image.fromarray(np.dstack([colours, colours[..., :1]])))
    x = (4 * np.arange(160) + 2 - undistortion.intrinsics[0, 2]) / undistortion.intrinsics[0, 0]
    y = (4 * np.arange(120) + 2 - undistortion.intrinsics[1, 2]) / undistortion.intrinsics[1, 1]
    shown = np.asarray(picture).astype(float)
    for channel, wanted in ((0, np.broadcast_to(x, (120, 160))), (1, np.broadcast_to(y[:, None], (120, 160)))):
        expected = 127.5 + 100 * wanted
        assert np.abs(shown[..., channel] - expected)[(expected > 2) & (expected < 253)].max() < 2.5


PARAMETERS = {
    "FULL_OPENCV": (-0.1, 0.02, 0.002, -0.001, 0.003, 0.05, -0.01, 0.002),
    "FOV": (0.8,),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "SIMPLE_RADIAL_FISHEYE": (0.03,),
    "RADIAL_FISHEYE": (0.03, -0.01),
    "THIN_PRISM_FISHEYE": (0.02, -0.01, 0.001, -0.002, 0.003, 0.0, 0.001, -0.001),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.02, -0.01, 0.003, 0.0, 0.0, 0.0, 0.001, -0.001, 0.001, 0.0, -0.001, 0.0),
    "SIMPLE_DIVISION": (-0.1,),
    "DIVISION": (-0.1,),
    "EUCM": (0.6, 1.1),
}


@pytest.mark.parametrize(("name", "binary"), [(name, number % 2 == 0) for number, name in enumerate(PARAMETERS)])
def test_a_photograph_is_undistorted_as_colmap_sees_it(tmp_path, name, binary):
    """Of every model: what pycolmap writes is read, and a photograph of its rays becomes a pinhole camera's."""
    pycolmap = pytest.importorskip("pycolmap")
    focal = [130.0] if name in colmap_files.ONE_FOCAL else [130.0, 128.0]
    camera = pycolmap.Camera(
        model=name, width=160, height=120, params=[*focal, 81.0, 59.0, *PARAMETERS[name]], camera_id=1
    )
    whole = pycolmap.Reconstruction()
    whole.add_camera_with_trivial_rig(camera)
    image = pycolmap.Image(name="a.png", camera_id=1, image_id=1)
    whole.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    (whole.write_binary if binary else whole.write_text)(tmp_path)
    stored = stored_cameras(tmp_path)["a.png"]

    v, u = np.meshgrid(np.arange(120) + 0.5, np.arange(160) + 0.5, indexing="ij")
    rays = camera.cam_from_img(np.stack([u, v], -1).reshape(-1, 2)).reshape(120, 160, 2)
    colours = (127.5 + 100 * rays).clip(0, 255).round().astype(np.uint8)
    picture = stored.undistortion.apply(Image.fromarray(np.dstack([colours, colours[..., :1]])))
    matrix = stored.undistortion.intrinsics
    wanted = np.stack([(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]], -1)
    assert np.abs(np.asarray(picture)[..., :2] - (127.5 + 100 * wanted)).max() < 2.5


def test_a_lens_without_distortion_leaves_photographs_alone():
    assert Lens(SIZE, (500.0, 500.0), (320.0, 240.0), (1e-5, 0.0, 0.0, 0.0)).undistortion() is None
    with pytest.raises(ValueError, match="leaves nothing"):
        Lens(SIZE, (500.0, 500.0), (-700.0, 240.0), (0.5, 0.0, 0.0, 0.0)).undistortion()
    with pytest.raises(ValueError, match="is invalid"):
        Lens(SIZE, (0.0, 500.0), (320.0, 240.0))
