#!/usr/bin/env bash
# Real spherical harmonics of six packages beside those of 3D Gaussian splatting, up to degree 3.
#
# `f_rest` of a PLY belongs to a basis whose first degree is (-y, z, -x): real and imaginary parts with the phase of
# Condon and Shortley. Whoever evaluates, rotates or fits colours with a package of harmonics gets, in the order of m:
#   SciPy 1.17.1, sqrt(2) times real and imaginary parts of sph_harm_y   the same
#   Dr.Jit 1.5.0 `sh_eval` (of Mitsuba)                                  the same
#   sphericart 2.0.4, pyshtools 4.14.1 (normalization="ortho")           odd m with the other sign: colours as they are
#                                               seen from the other side, turned by 180 degrees about z; pyshtools with
#                                               csphase=-1 the same as in splatting
#   pyshtools, by default                       the same times sqrt(4 pi), 3.5 times too much, besides the signs
#   e3nn 0.6.0                                  y is its vertical axis: given (y, z, x) it has sphericart's; of (x, y, z)
#                                               eight of the twelve functions from degree 2 on are none of splatting's;
#                                               normalization="integral" is its norm
# Seen: 200 directions.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 scipy==1.17.1 drjit==1.5.0 sphericart==2.0.4 pyshtools==4.14.1 torch==2.13.0 e3nn==0.6.0
env/bin/python - <<'PYTHON'
import drjit
import numpy as np
import pyshtools
import torch
from drjit.scalar import Array3f
from e3nn import o3
from scipy.special import sph_harm_y
from sphericart import SphericalHarmonics

directions = np.random.default_rng(0).normal(size=(200, 3))
directions /= np.linalg.norm(directions, axis=1, keepdims=True)
x, y, z = directions.T
orders = [(degree, m) for degree in range(4) for m in range(-degree, degree + 1)]
splatting = np.stack([
    0.28209479177387814 + 0 * x,
    *(-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x),
    *(1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y)),
    *(-1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)),
    *(-0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z),
    *(-0.4570457994644658 * y * (4 * z * z - x * x - y * y),),
    *(0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),),
    *(-0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y)),
    *(-0.5900435899266435 * x * (x * x - 3 * y * y),),
], 1)
polar, azimuth = np.arccos(z), np.arctan2(y, x)


def by_scipy(degree, m):
    value = sph_harm_y(degree, abs(m), polar, azimuth)
    return value.real if m == 0 else np.sqrt(2) * (value.imag if m < 0 else value.real)


def by_pyshtools(**options):
    angles = list(zip(np.degrees(polar), np.degrees(azimuth), strict=True))
    return np.array([[pyshtools.expand.spharm_lm(*order, *pair, **options) for order in orders] for pair in angles])


def by_e3nn(given):
    parts = [o3.spherical_harmonics(degree, torch.tensor(given), True, normalization="integral") for degree in range(4)]
    return torch.cat(parts, 1).numpy()


alternating = np.array([(-1) ** (m % 2) for _, m in orders])
found = {
    "SciPy": np.stack([by_scipy(*order) for order in orders], 1),
    "Dr.Jit": np.array([list(drjit.sh_eval(Array3f(*map(float, each)), 3)) for each in directions]),
    "pyshtools, ortho, csphase=-1": by_pyshtools(normalization="ortho", csphase=-1),
    "sphericart": SphericalHarmonics(3).compute(directions),
    "pyshtools, ortho": by_pyshtools(normalization="ortho"),
    "pyshtools": by_pyshtools() / np.sqrt(4 * np.pi),
    "e3nn of (y, z, x)": by_e3nn(np.stack([y, z, x], 1)),
}
for number, (name, values) in enumerate(found.items()):
    signs = np.sign((values * splatting).sum(0)).astype(int)
    print(f"{name}: {'as in splatting' if (signs == 1).all() else 'odd m with the other sign'}")
    assert np.allclose(values, splatting * (1 if number < 3 else alternating), atol=1e-5), name
plain = by_e3nn(directions)
norms = np.linalg.norm(plain, axis=0)[:, None] * np.linalg.norm(splatting, axis=0)
alike = np.abs(plain.T @ splatting / norms).max(0)
print(f"e3nn of (x, y, z): most alike of its functions, for each of splatting's: {alike.round(2)}")
assert (alike[:4] > 0.999).all() and (alike[4:] < 0.98).sum() == 8
assert np.allclose(by_scipy(1, 1), -np.sqrt(3 / (4 * np.pi)) * x)
PYTHON
echo "as described"
