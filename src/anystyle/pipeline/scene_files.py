"""The files of a scene besides renders: Gaussians as tensors, cameras as JSON, and a COLMAP model."""

from dataclasses import fields
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.names import names_below
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.io import colmap
from anystyle.io.atomic import write_json
from anystyle.io.checkpoint import save_tensors
from anystyle.pipeline.encode import EncodedCapture
from anystyle.types import Gaussians

CONVENTION = "OpenCV axes (x right, y down, z forward); intrinsics in source pixels; lengths in the scene's own unit"
MAX_POINTS = 100_000
"""Points of a COLMAP export: what an optimisation of Gaussians starts from."""


def save_gaussians(gaussians: Gaussians, path: Path) -> None:
    """Write every tensor of some Gaussians, without the loss of the PLY's conventions, as safetensors."""
    tensors = {item.name: getattr(gaussians, item.name).detach().cpu().contiguous() for item in fields(gaussians)}
    save_tensors(path, tensors, {"format": "anystyle/1 gaussians"})


def write_cameras(path: Path, encoded: EncodedCapture) -> None:
    """Write the cameras of the input views as readable JSON, whole or not at all.

    Intrinsics are in pixels of the source images; where known cameras were given, the similarity from their frame to
    the scene's is written, too.
    """
    cameras = encoded.cameras.to("cpu")
    rows = zip(
        encoded.sources, _source_intrinsics(encoded, cameras.intrinsics[0]), cameras.world_from_camera[0], strict=True
    )
    views = [
        {
            "name": source.name,
            "height": source.size[0],
            "width": source.size[1],
            "intrinsics": intrinsics.tolist(),
            "world_from_camera": pose.tolist(),
        }
        for source, intrinsics, pose in rows
    ]
    content: dict[str, object] = {"convention": CONVENTION, "views": views}
    if any(encoded.offset):
        content["offset"] = {"meaning": "to add to all positions", "xyz": encoded.offset}
    if encoded.scene_from_known is not None:
        scale, rotation, translation = encoded.scene_from_known
        content["scene_from_known"] = {
            "meaning": "scene = scale * rotation @ known + translation",
            "scale": float(scale),
            "rotation": rotation.tolist(),
            "translation": translation.tolist(),
        }
    write_json(path, content)


def write_colmap(folder: Path, gaussians: Gaussians, encoded: EncodedCapture, *, binary: bool) -> None:
    """Write one scene as a COLMAP model: cameras in source pixels, images, and the most opaque Gaussians as points."""
    opacities = gaussians.opacities[0].cpu()
    most_opaque = opacities.argsort(descending=True, stable=True)[: min(MAX_POINTS, int((opacities > 0).sum()))]
    rgb = rgb_from_constant(gaussians.harmonics[0, :, 0].cpu()[most_opaque])
    cameras = encoded.cameras.to("cpu").to(torch.float64)
    paths = [source.path for source in encoded.sources if source.path is not None]
    files = dict(zip(paths, names_below(paths), strict=True))
    model = colmap.pinhole_model(
        [f"{source.name}.png" if source.path is None else files[source.path] for source in encoded.sources],
        [source.size for source in encoded.sources],
        _source_intrinsics(encoded, cameras.intrinsics[0]).numpy(),
        cameras.camera_from_world[0].numpy(),
        gaussians.means[0].cpu()[most_opaque].double().numpy(),
        (rgb.clamp(0, 1) * 255).round().byte().numpy(),
    )
    colmap.write(model, folder, binary=binary)


def _source_intrinsics(encoded: EncodedCapture, intrinsics: Float[Tensor, "V 3 3"]) -> Float[Tensor, "V 3 3"]:
    pairs = zip(encoded.sources, intrinsics, strict=True)
    return torch.stack([source.source_intrinsics(matrix) for source, matrix in pairs])
