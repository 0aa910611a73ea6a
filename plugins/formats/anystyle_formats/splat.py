"""The ``.splat`` format of web viewers: 32 bytes per Gaussian, largest and most opaque first."""

from pathlib import Path

import numpy as np

from anystyle.contracts import Format
from anystyle.geometry.harmonics import CONSTANT
from anystyle.io.atomic import write_bytes
from anystyle.types import StyledScene
from anystyle_formats.packing import color_bytes, columns_of, in_bytes
from anystyle_formats.reading import gaussians, reading

ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])


class Splat(Format):
    """The ``.splat`` format of web viewers: 32 bytes per Gaussian, without view-dependent colour and notes."""

    reads = True
    max_degree = 0

    def write(self, scene: StyledScene, path: Path) -> None:
        means, rotations, scales, opacities, _ = columns = columns_of(scene.splats())
        rows = np.empty(len(means), ROW)
        rows["position"], rows["scale"] = means, scales
        rows["color"] = color_bytes(path, columns)
        rows["rotation"] = in_bytes(rotations * 128 + 128)
        write_bytes(path, rows[np.argsort(-opacities * scales.prod(1), kind="stable")].tobytes())

    def read(self, path: Path) -> StyledScene:
        with reading(path, ".splat file") as remarks:
            data = path.read_bytes()
            if more := len(data) % ROW.itemsize:
                remarks.guesses.append(f"{more} bytes behind the last Gaussian are left out")
            rows = np.frombuffer(data, ROW, len(data) // ROW.itemsize)
            color = rows["color"] / 255
            harmonics = (color[:, None, :3] - 0.5) / CONSTANT
            turns = (rows["rotation"].astype(np.float64) - 128) / 128
            scene = gaussians(remarks, rows["position"], turns, rows["scale"], color[:, 3], harmonics)
        return StyledScene(((path.stem, scene),))
