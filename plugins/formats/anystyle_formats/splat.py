"""The ``.splat`` format of web viewers: 32 bytes a Gaussian, largest and most opaque first."""

from pathlib import Path

import numpy as np
import torch.nn.functional as F

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_path
from anystyle.types import StyledScene
from anystyle_formats.reading import gaussians, reading

ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])
_CONSTANT = 0.28209479177387814  # the constant spherical harmonic


class Splat(Format):
    """The ``.splat`` format of web viewers: 32 bytes a Gaussian, without view-dependent colour and notes."""

    reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        splats = scene.splats()
        means, _, scales, opacities, harmonics = (tensor.detach().double().cpu().numpy() for tensor in splats)
        order = np.argsort(-opacities * scales.prod(1), kind="stable")
        rows = np.empty(len(means), ROW)
        rows["position"], rows["scale"] = means, scales
        color = np.concatenate([harmonics[:, 0] * _CONSTANT + 0.5, opacities[:, None]], 1)
        rows["color"] = np.round(color.clip(0, 1) * 255)
        unit = F.normalize(splats.rotations.detach().double().cpu(), dim=-1).numpy()
        rows["rotation"] = np.round(unit * 128 + 128).clip(0, 255)
        with atomic_path(path) as temporary:
            temporary.write_bytes(rows[order].tobytes())

    def read(self, path: Path) -> StyledScene:
        with reading(path, ".splat file") as remarks:
            rows = np.frombuffer(path.read_bytes(), ROW)
            color = rows["color"] / 255
            harmonics = (color[:, None, :3] - 0.5) / _CONSTANT
            turns = (rows["rotation"].astype(np.float64) - 128) / 128
            scene = gaussians(remarks, rows["position"], turns, rows["scale"], color[:, 3], harmonics)
        return StyledScene(((path.stem, scene),))
