"""Wavefront OBJ: a mesh with colours at its vertices, fused from what the scene's cameras see of it."""

import logging
from importlib.util import find_spec
from pathlib import Path

import torch

from anystyle.contracts import Format, Renderer
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.pipeline.load import default_device
from anystyle.registry.build import build
from anystyle.types import StyledScene
from anystyle_formats.mesh.depth import DepthViews, render_depth
from anystyle_formats.mesh.fusion import coverage, fused, pieces

MAX_VIEWS, LONG_SIDE = 64, 640
"""Cameras, evenly spaced of more, and the longer side in pixels, that depth is rendered for."""
AGREEMENT = 0.2
"""The smallest part of the surfaces that other cameras have to see at the same depth."""

COVERED, LARGEST = 0.1, 0.5
"""The smallest part of the surfaces that the cameras see, and of the faces that are in one piece, of a mesh."""
WHOLE = 0.8
"""A mesh with less of the surfaces is told of."""

_log = logging.getLogger(__name__)


class Obj(Format):
    """A mesh in Wavefront's OBJ, with a colour at each vertex; of scenes on whose depth their cameras agree."""

    up = "y"
    has_notes = needs_cameras = True

    def __init__(self) -> None:
        if find_spec("skimage") is None:
            raise ImportError('meshes need scikit-image: pip install "anystyle[mesh]"')

    def write(self, scene: StyledScene, path: Path) -> None:
        views = _views(scene)
        mesh = fused(views)
        covered, sizes = coverage(mesh, views), pieces(mesh)
        told = f"the mesh has {covered:.0%} of the surfaces that the cameras see, in pieces: {len(sizes)}"
        if covered < COVERED or sizes[0] < LARGEST * sizes.sum():
            raise UserError(
                f"{told}, the largest with {sizes[0] / sizes.sum():.0%} of the faces; {COVERED:.0%} and {LARGEST:.0%} "
                "are needed: photograph from more places, or fit with reconstruction=fit reconstruction.quality=best"
            )
        if covered < WHOLE:
            _log.warning("%s; the rest are holes, and what only some cameras see", told)
        lines = [f"# {note}" for note in scene.notes]
        rows = zip(mesh.vertices.tolist(), mesh.colors.tolist(), strict=True)
        lines += ["v {:.6g} {:.6g} {:.6g} {:.4f} {:.4f} {:.4f}".format(*point, *color) for point, color in rows]
        lines += ["f {} {} {}".format(*face) for face in (mesh.faces + 1).tolist()]
        with atomic_path(path) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="backslashreplace")


def _views(scene: StyledScene) -> DepthViews:
    """What the cameras see, where they agree on enough of it."""
    count = scene.cameras.intrinsics.shape[1]
    if count < 2:
        raise UserError(
            f"a mesh is made from two cameras or more, and this scene has {count or 'none'}; export the folder of "
            "anystyle stylize, or put cameras.json, transforms.json or a COLMAP model beside the file"
        )
    kept = torch.linspace(0, count - 1, min(count, MAX_VIEWS)).round().long()
    scale = min(1.0, LONG_SIDE / max(scene.cameras.size))
    height, width = (max(1, round(side * scale)) for side in scene.cameras.size)
    device = default_device()
    cameras = scene.cameras.select(kept).resized((height, width)).to(device)
    views = render_depth(scene.styles[-1][1].to(device), cameras, build(Renderer, "auto"))
    if views.agreement < AGREEMENT:
        raise UserError(
            f"of what the cameras see {views.agreement:.0%} is at the same depth for others, and a mesh needs "
            f"{AGREEMENT:.0%}; photograph from more places, or fit with reconstruction=fit reconstruction.quality=best"
        )
    return views
