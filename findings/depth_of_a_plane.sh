#!/usr/bin/env bash
# Depth of one plane, two units before the camera and parallel to the picture, by three packages: four numbers.
#
# 40 x 30 pixels, a focal length of 20. What projection wants is 2 in every pixel. In the middle, and in the corner:
#   Mitsuba 3.9.1, `aov` with `dd:depth`, and `depth`     1.99 and 3.13: along the ray, and from the near plane on. If
#                                                         none is given it is 0.01; 1.50 and 2.36 with 0.5, 1.00 and
#                                                         1.57 with 1
#                  `aov` with `pp:position`               z is 2.00 and 2.00
#   pyvista 0.49.1, `get_image_depth`                     -2.00 and -2.00
#   point-cloud-utils 0.34.0, `ray_mesh_intersection`     2.00 and 2.00 for directions with z = 1; 2.00 and 3.15 for
#                                                         those of length 1
# No warning. Depth of Mitsuba as truth is off by the near plane and bent to the corners: take its positions, with the
# camera's pose.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 mitsuba==3.9.1 vtk==9.7.2 pyvista==0.49.1 point-cloud-utils==0.34.0
env/bin/python - 2> log.txt <<'PYTHON'
import math

import mitsuba
import numpy as np
import point_cloud_utils
import pyvista

mitsuba.set_variant("scalar_rgb")
width, height, focal = 40, 30, 20.0
columns, rows = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
rays = np.stack([columns / focal, rows / focal, np.ones_like(rows)], -1)
lengths = np.linalg.norm(rays, axis=-1)
print(f"along the rays: {2 * lengths[15, 20]:.2f}, {2 * lengths[0, 0]:.2f}")


def by_mitsuba(integrator, **options):
    """Channels of the plane; many samples a pixel, of which the mean is that of the pixel's middle but for 0.005."""
    pose = mitsuba.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, -1, 0])
    place = mitsuba.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    sensor = {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(width / 2 / focal)),
        "to_world": pose,
        "film": film,
        "sampler": {"type": "independent", "sample_count": 256},
        **options,
    }
    plane = {"type": "rectangle", "to_world": place @ mitsuba.ScalarTransform4f().scale(10)}
    scene = mitsuba.load_dict({"type": "scene", "integrator": integrator, "sensor": sensor, "plane": plane})
    return np.array(mitsuba.render(scene))


for options in ({}, {"near_clip": 0.01}, {"near_clip": 0.5}, {"near_clip": 1.0}):
    channels = by_mitsuba({"type": "aov", "aovs": "dd:depth,pp:position"}, **options)
    depth, z = channels[..., 0], channels[..., 3]
    print(f"Mitsuba {options}: {depth[15, 20]:.2f}, {depth[0, 0]:.2f}; z {z[15, 20]:.2f}, {z[0, 0]:.2f}")
    assert np.allclose(depth, (2 - options.get("near_clip", 0.01)) * lengths, atol=0.005) and np.allclose(z, 2)
    assert np.allclose(by_mitsuba({"type": "depth"}, **options)[..., 0], depth, atol=0.005)

plotter = pyvista.Plotter(off_screen=True, window_size=(width, height))
plotter.add_mesh(pyvista.Plane(center=(0, 0, 2), direction=(0, 0, 1), i_size=20, j_size=20))
plotter.camera.position, plotter.camera.focal_point, plotter.camera.up = (0, 0, 0), (0, 0, 1), (0, -1, 0)
plotter.camera.view_angle = math.degrees(2 * math.atan(height / 2 / focal))
plotter.reset_camera_clipping_range()
plotter.show(auto_close=False)
found = plotter.get_image_depth()
print(f"pyvista: {found[15, 20]:.2f}, {found[0, 0]:.2f}")
assert np.allclose(found, -2, atol=0.01)

corners = np.array([[-10, -10, 2], [10, -10, 2], [10, 10, 2], [-10, 10, 2]], float)
faces = np.array([[0, 1, 2], [0, 2, 3]])
for directions, expected in ((rays, np.full_like(lengths, 2)), (rays / lengths[..., None], 2 * lengths)):
    directions = np.ascontiguousarray(directions.reshape(-1, 3))
    found = point_cloud_utils.ray_mesh_intersection(corners, faces, np.zeros_like(directions), directions)[2]
    found = found.reshape(height, width)
    print(f"point-cloud-utils: {found[15, 20]:.2f}, {found[0, 0]:.2f}")
    assert np.allclose(found, expected, rtol=1e-4)
PYTHON
echo "as described"
