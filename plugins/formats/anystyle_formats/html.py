"""One HTML file that shows a scene in its styles: 14 bytes a Gaussian, 3 more for each style; needs no network."""

import base64
import gzip
import html
import json
from importlib.resources import files
from math import sqrt
from pathlib import Path
from string import Template

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.io.atomic import atomic_path
from anystyle.io.splats import Splats
from anystyle.types import Cameras, StyledScene
from anystyle_formats.packing import morton_order, smallest_three
from anystyle_formats.provenance import json_ld, readable

_CONSTANT = 0.28209479177387814  # the constant spherical harmonic
_SCALE_RANGE = 14.0
"""Scales are clamped to this many natural logarithms below the largest: a millionth of it."""


class Html(Format):
    """One page with the scene in all its styles, the last of which is shown at first; opens in any browser.

    View-dependent colour is left out.
    """

    has_notes = many_styles = True

    def write(self, scene: StyledScene, path: Path) -> None:
        titles = [title for title, _ in scene.styles]
        styles = [scene.splats(index) for index in range(len(titles))]
        means = styles[0].means
        for title, style in zip(titles, styles, strict=True):
            if style.means.shape != means.shape or not bool((style.means == means).all()):
                raise UserError(f"the style {title!r} has other Gaussians than {titles[0]!r}; one page, one scene")
        blob, packing = _packed(titles, styles)
        manifest = packing | {
            "title": scene.title,
            "notes": readable(scene.notes),
            "first": len(styles) - 1,
            "cameras": _cameras(scene.cameras if scene.names else _looking_at(means, styles[0].opacities)),
        }
        assets = files("anystyle_formats") / "page"
        linked = json_ld(scene)
        page = Template((assets / "page.html").read_text(encoding="utf-8")).substitute(
            title=html.escape(scene.title or "A scene by anystyle"),
            style=(assets / "page.css").read_text(encoding="utf-8"),
            manifest=_script(manifest),
            linked=f'<script type="application/ld+json">{_script(linked)}</script>' if linked else "",
            data=base64.b64encode(gzip.compress(blob, mtime=0)).decode(),
            script=(assets / "page.js").read_text(encoding="utf-8"),
        )
        with atomic_path(path) as temporary:
            temporary.write_text(page, encoding="utf-8", errors="backslashreplace")


def _script(value: object) -> str:
    """JSON within a script element, which no text ends."""
    return json.dumps(value).replace("<", "\\u003c")


def _cameras(cameras: Cameras) -> list[dict[str, object]]:
    """Cameras in OpenCV's axes; ``axes`` are right, down and forward."""
    poses, intrinsics = cameras.world_from_camera[0].cpu(), cameras.intrinsics[0].cpu()
    return [
        {
            "position": pose[:3, 3].tolist(),
            "axes": pose[:3, :3].mT.tolist(),
            "focal": [float(matrix[0, 0]), float(matrix[1, 1])],
            "center": [float(matrix[0, 2]), float(matrix[1, 2])],
            "size": [cameras.size[1], cameras.size[0]],
        }
        for pose, matrix in zip(poses, intrinsics, strict=True)
    ]


def _packed(titles: list[str], styles: list[Splats]) -> tuple[bytes, dict[str, object]]:
    """The quantised scene, column by column, and what ``page.js`` needs to unpack it."""
    order = morton_order(styles[0].means.double().cpu().numpy())
    means, _, scales, opacities, _ = (tensor.detach().double().cpu().numpy()[order] for tensor in styles[0])
    far = np.sign(means) * np.log1p(np.abs(means))
    low, high = far.min(0), far.max(0)
    positions = np.round((far - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")
    largest = float(np.log(max(scales.max(), 1e-12)))
    logs = np.log(np.maximum(scales, 1e-12)).clip(largest - _SCALE_RANGE, None)
    smallest = min(float(logs.min()), largest - 1e-6)
    sizes = np.round((logs - smallest) / (largest - smallest) * 255).astype(np.uint8)
    alpha = np.round(opacities.clip(0, 1) * 255).astype(np.uint8)
    rotations: dict[bytes, int] = {}  # styles share rotations as a rule
    entries: list[dict[str, object]] = []
    colors: list[bytes] = []
    for title, style in zip(titles, styles, strict=True):
        rotation = rotations.setdefault(_rotations(style, order).tobytes(), len(rotations))
        entries.append({"title": title, "rotation": rotation})
        rgb = style.harmonics[:, 0].detach().double().cpu().numpy()[order] * _CONSTANT + 0.5
        colors.append(np.round(rgb.clip(0, 1) * 255).astype(np.uint8).T.tobytes())
    columns = (column.T.tobytes() for column in (positions, sizes, alpha))
    return b"".join((*rotations, *columns, *colors)), {
        "count": len(means),
        "low": low.tolist(),
        "high": high.tolist(),
        "scales": [smallest, largest],
        "rotations": list(range(len(rotations))),
        "styles": entries,
    }


def _rotations(splats: Splats, order: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Smallest-three: 2 bits for the index of the largest of wxyz, 10 for each other as a fraction of ±1/√2."""
    wxyz = F.normalize(splats.rotations.detach().double().cpu(), dim=-1).numpy()[order]
    largest, others = smallest_three(wxyz)
    parts = np.round((others / sqrt(2) + 0.5) * 1023).clip(0, 1023).astype(np.uint32)
    return (largest.astype(np.uint32) << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]).astype("<u4")


def _looking_at(
    means: Float[Tensor, "N 3"], opacities: Float[Tensor, " N"], size: tuple[int, int] = (600, 800)
) -> Cameras:
    """A camera that shows the middle of a scene, from where 3DGS's axes look: along z, y down."""
    visible = means[opacities > 0.1]
    points = visible if len(visible) else means
    center = points.median(0).values
    radius = (points - center).norm(dim=-1).quantile(0.8) if len(points) < 2**23 else points.std()
    eye = center - torch.tensor([0.0, 0.0, 2.0]) * radius.clamp_min(1e-3)
    height, width = size
    focal = float(width)
    intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Cameras(look_at(eye[None], center[None])[None], intrinsics[None, None], size)
