"""The procedural scenes: geometry that is exact, bytes that are the same, pictures that are fit to learn from."""

import hashlib
import inspect
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from anystyle.contracts import SceneSource
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.types import Views
from anystyle_tiny.procedural.layout import Builder, Draw, unit_circle
from anystyle_tiny.procedural.raycast import EXTENT, HORIZON, LIGHT, SETTING_COLUMNS, SUN, cast
from anystyle_tiny.procedural.scenes import ProceduralScenes
from anystyle_tiny.procedural.solids import BOX, CONE, CYLINDER, SOLIDS, SPHERE, hit_solid
from anystyle_tiny.procedural.textures import PLAIN, ROUGH
from anystyle_tiny.procedural.volumes import sine, volumes


@pytest.fixture(scope="module")
def source():
    return ProceduralScenes(size=48)


def reprojection_error(views: Views) -> float:
    """Median colour difference between a view and the other one seen through its depth, where both see the point."""
    depth, cameras = views.depth[0], views.cameras
    size = depth.shape[-1]
    grid = torch.arange(size) + 0.5
    v, u = torch.meshgrid(grid, grid, indexing="ij")
    k = cameras.intrinsics[0, 0]
    ray = torch.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], torch.ones_like(u), 1 / depth[0]], -1)
    local = (ray * depth[0][..., None]) @ (cameras.camera_from_world[0, 1] @ cameras.world_from_camera[0, 0]).T
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    place = torch.stack([x / z * k[0, 0] + k[0, 2], y / z * k[1, 1] + k[1, 2]], -1) / size * 2 - 1
    other = torch.cat([views.images[0, 1], depth[1:]])
    seen = torch.nn.functional.grid_sample(other[None], place[None], align_corners=False)[0]
    visible = (place.abs() < 0.97).all(-1) & (z > 0) & ((seen[3] - z).abs() < 0.01 * z)
    assert visible.float().mean() > 0.25
    return (seen[:3] - views.images[0, 0]).abs().mean(0)[visible].median().item()


def test_depth_and_poses_explain_the_colours_of_other_views():
    source = ProceduralScenes(size=64)
    errors = [reprojection_error(source.read(scene, [1, 4])) for scene in range(8)]
    assert np.median(errors) < 0.02 and max(errors) < 0.05


def lone_solid(shape, centre, half, angle=0.0):
    build = Builder(Draw((0,)), 0.0)
    for _ in range(SOLIDS + 1):
        build.material((PLAIN,), (1.0, 2.0))
    build.solid(shape, centre, half, SOLIDS, unit_circle(angle))
    settings = np.zeros(SETTING_COLUMNS)
    settings[EXTENT], settings[LIGHT + 1], settings[SUN : SUN + 3], settings[HORIZON : HORIZON + 3] = 50, 1, 1, 0.5
    return settings, np.stack(build.solids), np.stack(build.materials)


def look(world, pose, focal, size):
    color, depth, labels = np.empty((*size, 3)), np.empty(size), np.empty(size, np.int64)
    cast((*world, volumes()), pose, focal, color, depth, labels, 2)
    return color, depth, labels


def test_depth_of_a_sphere_is_its_closed_form():
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 2.0, -4.0]
    centre, radius, focal, size = np.array([0.3, 1.8, 0.5]), 0.8, 60.0, (40, 52)
    _, depth, labels = look(lone_solid(SPHERE, tuple(centre), (radius,) * 3), pose, focal, size)
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    ray = np.stack([(u - size[1] / 2) / focal, (v - size[0] / 2) / focal, np.ones(size)], -1)
    to = centre - pose[:3, 3]
    a, b, c = (ray * ray).sum(-1), ray @ to, to @ to - radius**2
    disc = b * b - a * c
    np.testing.assert_array_equal(labels == SOLIDS, disc > 0)
    seen = disc > 0
    np.testing.assert_allclose(depth[seen], ((b - np.sqrt(np.where(seen, disc, 0))) / a)[seen], rtol=1e-12)
    assert 300 < seen.sum() < 1500


INSIDE = {
    SPHERE: lambda p: (p**2).sum() < 1,
    BOX: lambda p: np.abs(p).max() < 1,
    CYLINDER: lambda p: p[0] ** 2 + p[2] ** 2 < 1 and abs(p[1]) < 1,
    CONE: lambda p: p[0] ** 2 + p[2] ** 2 < (0.5 - 0.5 * p[1]) ** 2 and abs(p[1]) < 1,
}


def vectors(low, high):
    return st.tuples(*[st.floats(low, high)] * 3)


@settings(deadline=None)  # the first call compiles kernels
@given(st.sampled_from(sorted(INSIDE)), st.floats(-3, 3), vectors(0.2, 1.5), vectors(-3, 3), vectors(-1, 1))
def test_a_ray_meets_a_solid_where_it_enters_it(shape, angle, half, origin, aim):
    """March along the ray with the solid's implicit form: nothing before the hit is inside, what follows is."""
    solids = lone_solid(shape, (0.2, 0.1, -0.3), half, angle)[1]
    direction = np.array(aim) * 0.9 + [0.2, 0.1, -0.3] - np.array(origin)
    if np.linalg.norm(direction) < 1e-2:
        return
    c, s = unit_circle(angle)

    def inside(t):
        x, y, z = np.array(origin) + t * direction - [0.2, 0.1, -0.3]
        return INSIDE[shape](np.array([(c * x - s * z) / half[0], y / half[1], (s * x + c * z) / half[2]]))

    if inside(0.0) or inside(1e-6):  # an origin on the surface is on neither side
        return
    hit = hit_solid(solids, 0, tuple(origin), tuple(direction), 1e-9)
    assert not any(inside(t) for t in np.linspace(0, min(hit, 3.0) - 1e-6, 200))
    if np.isfinite(hit):
        # At a grazing hit the way inside is short: any of a few depths will do.
        grazing = all(not inside(hit + step) for step in (1e-6, 1e-4, 1e-3, 1e-2))
        assert not grazing or not any(inside(hit + step) for step in np.linspace(0.02, 2, 50))


def test_a_sphere_throws_its_shadow_where_the_light_says():
    world = lone_solid(SPHERE, (0.0, 2.0, 0.0), (0.5, 0.5, 0.5))
    world[0][LIGHT : LIGHT + 3] = [1.0, 1.0, 0.0]
    world[2][:, ROUGH] = 0.0
    down = np.array([[1.0, 0, 0, 0], [0, 0, -1, 10], [0, -1, 0, 0], [0, 0, 0, 1]])
    color, _, labels = look(world, down, 80.0, (64, 64))
    x = (np.arange(64) + 0.5 - 32) / 80 * 10
    lit = color[32, :, 0]
    shadow = (lit < 0.5 * np.median(lit)) & (labels[32] != SOLIDS)
    # The light comes from +x at 45 degrees: the shadow of a ball at height 2 lies around x = -2, longer than wide.
    assert abs(x[shadow].mean() + 2.0) < 0.1
    assert abs(np.ptp(x[shadow]) - 2 * 0.5 * np.sqrt(2)) < 0.3


def test_the_first_view_is_at_unit_distance_and_nothing_fills_a_view(source):
    for scene in range(12):
        views = source.read(scene, range(6))
        assert views.depth[0, 0].mean().item() == pytest.approx(1.0, abs=0.05)
        assert views.depth.min() > 0.05 and views.depth.max() < 20
        near = views.depth[0] < 0.45 * views.depth[0].flatten(1).median(1).values[:, None, None]
        assert near.float().mean((1, 2)).max() < 0.4
        assert 0.2 < views.images.mean() < 0.75 and views.images.std() > 0.06
        assert ((views.images == 1).float().mean() < 0.1) and ((views.images == 0).float().mean() < 0.02)


def bytes_of(size, scene, views):
    out = ProceduralScenes(size=size, seed=3, split="validation").read(scene, views)
    digest = hashlib.sha256()
    for tensor in (out.images, out.depth, out.cameras.world_from_camera, out.cameras.intrinsics):
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


@pytest.mark.slow
def test_bytes_are_the_same_in_another_process_and_in_threads():
    load = "ProceduralScenes = catalog().find('scenes', 'procedural').load()"
    imports = f"import hashlib\nfrom anystyle.registry.catalog import catalog\n{load}"
    program = f"{imports}\n{inspect.getsource(bytes_of)}\nprint(bytes_of(40, 5, [0, 3]))"
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()
    source = ProceduralScenes(size=40, seed=3, split="validation")
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda scene: source.read(scene, [0, 3]).images.sum().item(), [5, 6, 7, 8] * 3))
    assert bytes_of(40, 5, [0, 3]) == other
    assert together[:4] == together[4:8] == together[8:]


def test_size_does_not_change_the_scene():
    small, wide = ProceduralScenes(size=32).read(2, [0, 5]), ProceduralScenes(size=64, width=96).read(2, [0, 5])
    assert wide.images.shape[-2:] == (64, 96)
    assert torch.equal(small.cameras.world_from_camera, wide.cameras.world_from_camera)
    reduced = torch.nn.functional.avg_pool2d(wide.images[..., 16:80].flatten(0, 1), 2).unflatten(0, (1, 2))
    assert (reduced - small.images).abs().median() < 0.02
    focal = 2 * small.cameras.intrinsics[0, 0, 0, 0].item()
    expected = torch.tensor([[focal, 0, 48], [0, focal, 32], [0, 0, 1]])
    torch.testing.assert_close(wide.cameras.intrinsics, expected.expand(1, 2, 3, 3))


@settings(deadline=None)  # the first call compiles kernels
@given(st.floats(-100, 100))
def test_the_sine_of_our_own(angle):
    assert sine(angle) == pytest.approx(np.sin(angle), abs=2e-7)
    c, s = unit_circle(angle)
    assert c * c + s * s == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("option", "value"), [("size", 0), ("width", 5000), ("num_scenes", 0), ("views", 0), ("seed", -1), ("samples", 0)]
)
def test_options_out_of_range_are_refused(option, value):
    with pytest.raises(UserError, match=f"{option}={value}"):
        build(SceneSource, {"_target_": f"{ProceduralScenes.__module__}.ProceduralScenes", option: value})


@pytest.mark.parametrize(
    ("scene", "views", "message"), [(10000, [0], "there are 10000"), (0, [6], "0 to 5"), (0, [], "at least one")]
)
def test_scenes_and_views_that_are_not_there_are_refused(scene, views, message, source):
    with pytest.raises(ValueError, match=message):
        source.read(scene, views)
