"""The plain ``.splat`` of web viewers: 32 bytes a Gaussian, colours without direction, the most visible first."""

from pathlib import Path

import numpy as np
import torch.nn.functional as F

from anystyle.io.atomic import atomic_path
from anystyle.io.ply import Splats

ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])
_CONSTANT = 0.28209479177387814


def write(splats: Splats, path: Path, notes: str = "") -> None:
    """Write one scene in 3DGS's axes, whole or not at all; notes are lost, for the format has no header."""
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
