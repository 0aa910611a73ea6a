"""Quantising a scene for its page: 14 bytes a Gaussian, 3 more for each style."""

import base64
import gzip
import html
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from math import sqrt
from pathlib import Path
from string import Template

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray

from anystyle.io.atomic import atomic_path
from anystyle.io.packing import morton_order, smallest_three
from anystyle.io.ply import Splats

_CONSTANT = 0.28209479177387814
_SCALE_RANGE = 14.0
"""Logarithms of scales under the largest by more than this are cut: a millionth."""


@dataclass(frozen=True)
class PageStyle:
    """A style of the scene.

    Args:
        title: For its button.
        splats: The Gaussians in it: of the same places, sizes and opacities as in every other style of the page.
    """

    title: str
    splats: Splats


@dataclass(frozen=True)
class PageCamera:
    """A place to look from, in OpenCV's axes.

    Args:
        position: In the scene.
        axes: Right, down and forward, as unit vectors.
        focal: In pixels, of both axes.
        center: Principal point in pixels.
        size: Width and height in pixels.
    """

    position: Sequence[float]
    axes: Sequence[Sequence[float]]
    focal: tuple[float, float]
    center: tuple[float, float]
    size: tuple[int, int]


def write(
    path: Path,
    styles: Sequence[PageStyle],
    cameras: Sequence[PageCamera],
    *,
    title: str = "",
    notes: Sequence[str] = (),
    first: int = 0,
) -> None:
    """Write the page; whole or not at all. Colours that change with the direction are shown without that change.

    Args:
        path: An ``.html`` file.
        styles: At least one.
        cameras: At least one; the page begins at the first.
        title: For people.
        notes: Lines of the caption, such as licences.
        first: The style that is shown at first.

    Raises:
        ValueError: Styles are not of one geometry.
    """
    geometry = styles[0].splats
    for style in styles[1:]:
        if style.splats.means.shape != geometry.means.shape or not bool((style.splats.means == geometry.means).all()):
            raise ValueError(
                f"the style {style.title!r} has other Gaussians than {styles[0].title!r}; one page, one scene"
            )
    order = morton_order(geometry.means.double().cpu().numpy())
    blob, manifest = _packed(styles, order)
    manifest |= {
        "title": title,
        "notes": list(notes),
        "first": first,
        "cameras": [asdict(camera) for camera in cameras],
    }
    assets = files("anystyle.io.page")
    # Nothing in a text of people's ends the element that it is in.
    text = json.dumps(manifest).replace("<", "\\u003c")
    page = Template((assets / "page.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(title or "A scene by anystyle"),
        style=(assets / "page.css").read_text(encoding="utf-8"),
        manifest=text,
        data=base64.b64encode(gzip.compress(blob, mtime=0)).decode(),
        script=(assets / "page.js").read_text(encoding="utf-8"),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _packed(styles: Sequence[PageStyle], order: NDArray[np.int64]) -> tuple[bytes, dict[str, object]]:
    """What the page unpacks, and how."""
    means, _, scales, opacities, _ = (tensor.detach().double().cpu().numpy()[order] for tensor in styles[0].splats)
    far = np.sign(means) * np.log1p(np.abs(means))
    low, high = far.min(0), far.max(0)
    positions = np.round((far - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")
    largest = float(np.log(max(scales.max(), 1e-12)))
    logs = np.log(np.maximum(scales, 1e-12)).clip(largest - _SCALE_RANGE, None)
    smallest = min(float(logs.min()), largest - 1e-6)
    sizes = np.round((logs - smallest) / (largest - smallest) * 255).astype(np.uint8)
    rotations: list[NDArray[np.uint32]] = []
    entries: list[dict[str, object]] = []
    colors: list[NDArray[np.uint8]] = []
    for style in styles:
        packed = _rotations(style.splats, order)
        known = next((index for index, other in enumerate(rotations) if np.array_equal(other, packed)), len(rotations))
        if known == len(rotations):
            rotations.append(packed)
        entries.append({"title": style.title, "rotation": known})
        rgb = style.splats.harmonics[:, 0].detach().double().cpu().numpy()[order] * _CONSTANT + 0.5
        colors.append(np.round(rgb.clip(0, 1) * 255).astype(np.uint8))
    alpha = np.round(opacities.clip(0, 1) * 255).astype(np.uint8)
    blob = b"".join(column.T.tobytes() for column in (*rotations, positions, sizes, alpha, *colors))
    manifest: dict[str, object] = {
        "count": len(means),
        "low": low.tolist(),
        "high": high.tolist(),
        "scales": [smallest, largest],
        "rotations": list(range(len(rotations))),
        "styles": entries,
    }
    return blob, manifest


def _rotations(splats: Splats, order: NDArray[np.int64]) -> NDArray[np.uint32]:
    """The index of the largest of wxyz in 2 bits, and the others in 10 each as shares of ±1/√2."""
    wxyz = F.normalize(splats.rotations.detach().double().cpu(), dim=-1).numpy()[order]
    largest, others = smallest_three(wxyz)
    parts = np.round((others / sqrt(2) + 0.5) * 1023).clip(0, 1023).astype(np.uint32)
    return (largest.astype(np.uint32) << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]).astype("<u4")
