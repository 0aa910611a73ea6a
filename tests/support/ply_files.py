"""PLY files of Gaussians as people have them, written without the reader's library."""

import numpy as np

from tests.support.strange_splats import ply

POSITION, COLOR, OPACITY = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2"), ("opacity",)
SCALE, ROTATION = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
BASE = (*POSITION, *COLOR, *OPACITY, *SCALE, *ROTATION)


def columns(count=300, names=BASE):
    """Small Gaussians about the origin: logits about 0, scales of exp(-4)."""
    rows = np.random.default_rng(0).normal(0, 0.3, (count, len(BASE)))
    rows[:, 7:10], rows[:, 10:] = -4, (1, 0, 0, 0)
    return {name: column for name, column in zip(BASE, rows.T, strict=True) if name in names}


def write_ply(path, values, *, header=b"", kinds=None, order="<"):
    """Write columns by name, in ASCII if ``order`` is empty; float32 but for other ``kinds``, as ``{"x": "f8"}``."""
    path.write_bytes(ply(values, order, kinds, comments=header))
    return path
