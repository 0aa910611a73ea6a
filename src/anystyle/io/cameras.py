"""Cameras as readable JSON: what ``anystyle stylize`` writes as ``cameras.json``."""

from collections.abc import Sequence
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from anystyle.io.atomic import write_json

CONVENTION = "OpenCV axes (x right, y down, z forward); intrinsics in source pixels; lengths in the scene's own unit"


def write(
    path: Path,
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    intrinsics: Float[Tensor, "V 3 3"],
    world_from_camera: Float[Tensor, "V 4 4"],
    *,
    scene_from_known: tuple[Float[Tensor, ""], Float[Tensor, "3 3"], Float[Tensor, "3"]] | None = None,
) -> None:
    """Write the cameras of one scene; whole or not at all.

    Args:
        path: A JSON file.
        names: Of the views.
        sizes: Height and width of each view's source in pixels.
        intrinsics: In pixels of the sources.
        world_from_camera: Rigid motions in OpenCV axes.
        scene_from_known: Scale, rotation and translation from the frame of known cameras to the scene's, where there
            are any.
    """
    views = [
        {
            "name": name,
            "height": height,
            "width": width,
            "intrinsics": intrinsics[view].tolist(),
            "world_from_camera": world_from_camera[view].tolist(),
        }
        for view, (name, (height, width)) in enumerate(zip(names, sizes, strict=True))
    ]
    content: dict[str, object] = {"convention": CONVENTION, "views": views}
    if scene_from_known is not None:
        scale, rotation, translation = scene_from_known
        content["scene_from_known"] = {
            "meaning": "scene = scale * rotation @ known + translation",
            "scale": float(scale),
            "rotation": rotation.tolist(),
            "translation": translation.tolist(),
        }
    write_json(path, content)
