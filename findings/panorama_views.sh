#!/usr/bin/env bash
# Views cut from a panorama: whose pixels look where a pinhole camera of that field of view says?
#
# Of FFmpeg's filter v360, py360convert 1.0.4, pytorch360convert 0.2.3 and pyequilib 0.6.0, the first one's. In a view
# of N pixels and 90 degrees, pixel i should look along (2 i + 1 - N) / N from the axis. Those of py360convert and
# pytorch360convert look along (2 i + 1 - N) / (N - 1): the outer pixels' centres lie on the edges of the field of
# view, the focal length is (N - 1) / 2. Those of pyequilib, by which nerfstudio cuts panoramas, are off by half a pixel
# of the view to the left, less a pixel of the panorama. By `yaw` pyequilib turns left, by `pitch` down;
# the others turn right and up. No warning.
# Seen: a panorama of 1024 x 512 pixels whose values are the directions in which they lie.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 scipy==1.17.1 torch==2.13.0 py360convert==1.0.4 av==18.1.0
env/bin/pip install --quiet --no-deps pyequilib==0.6.0 pytorch360convert==0.2.3
env/bin/python - <<'PYTHON'
import av
import equilib
import numpy as np
import py360convert
import pytorch360convert
import torch

WIDTH, HEIGHT, N = 1024, 512, 16
longitude, latitude = np.meshgrid(
    ((np.arange(WIDTH) + 0.5) / WIDTH * 2 - 1) * np.pi, (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT) * np.pi
)
panorama = np.stack(
    [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)], axis=-1
)


def v360(right=0, up=0):
    graph = av.filter.Graph()
    source = graph.add_buffer(width=WIDTH, height=HEIGHT, format="gbrp16le", time_base="1/25")
    view = graph.add("v360", f"input=e:output=flat:h_fov=90:v_fov=90:w={N}:h={N}:interp=linear:yaw={right}:pitch={up}")
    sink = graph.add("buffersink")
    source.link_to(view)
    view.link_to(sink)
    graph.configure()
    levels = np.round((panorama + 1) / 2 * 65535).astype("<u2")
    frame = av.VideoFrame.from_ndarray(levels, format="rgb48le").reformat(format="gbrp16le")
    frame.pts = 0
    graph.push(frame)
    return graph.pull().reformat(format="rgb48le").to_ndarray() / 65535 * 2 - 1


def numpy360(right=0, up=0):
    return py360convert.e2p(panorama, fov_deg=(90, 90), u_deg=right, v_deg=up, out_hw=(N, N), mode="bilinear")


def torch360(right=0, up=0):
    image = torch.from_numpy(panorama).permute(2, 0, 1)
    view = pytorch360convert.e2p(image, (90.0, 90.0), h_deg=right, v_deg=up, out_hw=(N, N), mode="bilinear")
    return view.permute(1, 2, 0).numpy()


def pyequilib(right=0, up=0):
    turns = {"roll": 0.0, "pitch": np.radians(up), "yaw": np.radians(right)}
    view = equilib.equi2pers(panorama.transpose(2, 0, 1), turns, height=N, width=N, fov_x=90.0, mode="bilinear")
    return view.transpose(1, 2, 0)


pixels = np.arange(N)
pinhole, edges = (2 * pixels + 1 - N) / N, (2 * pixels + 1 - N) / (N - 1)
shifted = np.tan(np.arctan(pinhole - 1 / N) + 2 * np.pi / WIDTH)
for name, cut, expected, sign in (
    ("v360", v360, pinhole, 1),
    ("py360convert", numpy360, edges, 1),
    ("pytorch360convert", torch360, edges, 1),
    ("pyequilib", pyequilib, shifted, -1),
):
    view = cut()
    across = view[N // 2, :, 0] / view[N // 2, :, 2]
    down = -view[:, N // 2, 1] / view[:, N // 2, 2]
    turned, raised = (cut(**by)[N // 2, N // 2] for by in ({"right": 90}, {"up": 30}))
    print(f"{name}: pixels 0, 7, 8 and 15 look along {across[[0, 7, 8, 15]].round(4)}; "
          f"x after yaw {turned[0]:.2f}, y after pitch {raised[1]:.2f}")
    assert np.abs(across - expected).max() < 3e-3 and np.abs(down - expected).max() < 5e-3, (across, down, expected)
    assert np.sign(turned[0]) == np.sign(raised[1]) == sign
PYTHON
echo "as described"
