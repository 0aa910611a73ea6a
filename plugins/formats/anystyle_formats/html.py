"""One HTML file that shows a scene in its styles: 14 bytes per Gaussian, 3 more for each style; needs no network."""

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
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Format
from anystyle.geometry import confidence
from anystyle.geometry.cameras import look_at
from anystyle.geometry.harmonics import CONSTANT
from anystyle.io.atomic import write_text
from anystyle.io.sheet import data_url
from anystyle.io.splats import Splats
from anystyle.types import Cameras, StyledScene
from anystyle_formats.packing import codebook, columns_of, in_bytes, in_words, joined_bits, morton_order, smallest_three
from anystyle_formats.views import best_view

_PICTURE = 80
"""Longer side of the picture of a style in pixels: two for each that it is shown at."""


class Html(Format):
    """One page with the scene in all its styles, the last of which is shown at first; opens in any browser.

    View-dependent colour is left out.
    """

    has_antialiasing = has_notes = many_styles = True
    shared = ("means", "scales", "opacities")
    max_degree = 0

    def write(self, scene: StyledScene, path: Path) -> None:
        blob, packing, entries = _packed([scene.splats(index) for index in range(len(scene.styles))])
        for (title, _), entry in zip(scene.styles, entries, strict=True):
            entry["title"] = title
            if title in scene.pictures:
                entry["picture"] = _small(scene.pictures[title])
        manifest = json.dumps(_manifest(scene) | packing | {"styles": entries, "first": len(entries) - 1})
        template, style, script = (
            (files("anystyle_formats") / "page" / f"page.{kind}").read_text(encoding="utf-8")
            for kind in ("html", "css", "js")
        )
        page = Template(template).substitute(
            title=html.escape(scene.title or "A scene by anystyle"),
            style=style,
            manifest=manifest.replace("<", "\\u003c"),  # no text in it ends the script
            data=base64.b64encode(gzip.compress(blob, mtime=0)).decode(),
            script=script,
        )
        write_text(path, page)


def _manifest(scene: StyledScene) -> dict[str, object]:
    """What ``page.js`` is told of a scene besides its Gaussians."""
    splats = scene.splats(0)
    cameras = scene.cameras if scene.names else _looking_at(splats.means, splats.opacities)
    return {
        "title": scene.title,
        "antialiased": scene.antialiased,
        "notes": scene.notes,
        "opening": best_view(splats.means, splats.opacities, cameras),
        "cameras": _cameras(cameras),
        "fade": _fade(scene) if scene.names and scene.photographed else None,
    }


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


def _fade(scene: StyledScene) -> dict[str, float]:
    """What ``page.js`` computes :class:`~anystyle.geometry.confidence.ViewConfidence` with."""
    rows, columns = confidence.CELLS
    spacing = confidence.ViewConfidence.of(scene.styles[0][1], scene.cameras).spacing
    names = ("points", "opaque", "margin", "behind", "near", "far", "beyond")
    shared = {name: getattr(confidence, name.upper()) for name in names}
    return {**shared, "spacing": spacing, "rows": rows, "columns": columns}


def _small(picture: Image.Image) -> str:
    """A picture of a style as a ``data:`` URL."""
    small = picture.convert("RGB")
    small.thumbnail((_PICTURE, _PICTURE), Image.Resampling.LANCZOS)
    return data_url(small, "webp", quality=70, method=6)


def _packed(styles: list[Splats]) -> tuple[bytes, dict[str, object], list[dict[str, object]]]:
    """The quantised scene, column by column, what ``page.js`` needs to unpack it, and the same of each style."""
    columns = [columns_of(style) for style in styles]
    order = morton_order(columns[0].means)
    means, _, scales, opacities, _ = (column[order] for column in columns[0])
    positions, low, high = in_words(means)
    levels, sizes = codebook(np.log(np.maximum(scales, 1e-12)))
    rotations: dict[bytes, int] = {}  # styles share rotations as a rule
    entries: list[dict[str, object]] = []
    colors: list[bytes] = []
    for style in columns:
        # The other components are fractions of ±1/√2.
        largest_of, others = smallest_three(style.rotations[order])
        fractions = np.round((others / sqrt(2) + 0.5) * 1023).clip(0, 1023).astype(np.uint32)
        rotation = rotations.setdefault(joined_bits(largest_of, fractions).tobytes(), len(rotations))
        entries.append({"rotation": rotation})
        colors.append(in_bytes((style.harmonics[order, 0] * CONSTANT + 0.5) * 255).T.tobytes())
    shared = (column.T.tobytes() for column in (positions, sizes, in_bytes(opacities * 255)))
    return (
        b"".join((*rotations, *shared, *colors)),
        {
            "count": len(means),
            "low": low.tolist(),
            "high": high.tolist(),
            "scales": levels.round(5).tolist(),
            "rotations": list(range(len(rotations))),
        },
        entries,
    )


def _looking_at(means: Float[Tensor, "N 3"], opacities: Float[Tensor, " N"]) -> Cameras:
    """A camera that shows the middle of a scene, from where 3DGS's axes look: along z, y down."""
    visible = means[opacities > 0.1]
    points = visible if len(visible) else means
    center = points.median(0).values
    radius = (points - center).norm(dim=-1).quantile(0.8) if len(points) < 2**23 else points.std()
    eye = center - torch.tensor([0.0, 0.0, 2.0]) * radius.clamp_min(1e-3)
    intrinsics = torch.tensor([[800.0, 0.0, 400.0], [0.0, 800.0, 300.0], [0.0, 0.0, 1.0]])
    return Cameras(look_at(eye[None], center[None])[None], intrinsics[None, None], (600, 800))
