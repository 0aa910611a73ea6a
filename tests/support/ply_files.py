"""PLY files of Gaussians as people have them, written without the reader's library."""

import numpy as np

POSITION, COLOR, OPACITY = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2"), ("opacity",)
SCALE, ROTATION = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
BASE = (*POSITION, *COLOR, *OPACITY, *SCALE, *ROTATION)
KINDS = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
FORMATS = {"<": "binary_little_endian", ">": "binary_big_endian", "ascii": "ascii"}


def columns(count=300, names=BASE):
    """Small Gaussians about the origin: logits about 0, scales of exp(-4)."""
    rows = np.random.default_rng(0).normal(0, 0.3, (count, len(BASE)))
    rows[:, 7:10], rows[:, 10:] = -4, (1, 0, 0, 0)
    return {name: column for name, column in zip(BASE, rows.T, strict=True) if name in names}


def write_ply(path, values, *, header=b"", kinds=None, order="<"):
    """Write columns by name; float32 but for those of other ``kinds``, such as ``{"x": "f8"}``."""
    kinds = dict.fromkeys(values, "f4") | (kinds or {})
    byte_order = order if order != "ascii" else "<"
    table = np.empty(len(next(iter(values.values()))), [(name, byte_order + kinds[name]) for name in values])
    for name, column in values.items():
        table[name] = column
    lines = [f"ply\nformat {FORMATS[order]} 1.0\n".encode(), header, f"element vertex {len(table)}\n".encode()]
    lines += [f"property {KINDS[kinds[name]]} {name}\n".encode() for name in values]
    body = "\n".join(" ".join(map(repr, row.tolist())) for row in table).encode() + b"\n"
    path.write_bytes(b"".join([*lines, b"end_header\n", table.tobytes() if order != "ascii" else body]))
    return path
