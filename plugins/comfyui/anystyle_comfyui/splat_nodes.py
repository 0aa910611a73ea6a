"""From and to ComfyUI's own type of Gaussian scenes, ``SPLAT``; only for versions that have it."""

import importlib
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, ClassVar

from .nodes import CAPTURE, SCENE, Node, folder_paths, io
from .running import running
from .values import Scene, gaussians_from_splat, splat_columns

types: Any = importlib.import_module("comfy_api.latest").Types


class SceneToSplat(Node):
    """A scene for ComfyUI's own splat nodes."""

    title = "Scene to Splat"
    inputs: ClassVar = [SCENE.Input("scene")]
    outputs: ClassVar = [io.Splat.Output(display_name="splat")]

    @classmethod
    def execute(cls, scene: Scene) -> Any:
        """Convert it; every number stays as it is, and quaternions are normalised."""
        return io.NodeOutput(types.SPLAT(**splat_columns(scene.gaussians)))


class CaptureFromSplat(Node):
    """A splat of ComfyUI's own nodes, for Fit Scene: it keeps its geometry, and is seen from cameras around it."""

    title = "Capture from Splat"
    index = io.Int.Input("index", default=0, min=0, max=4096, tooltip="Place in a batch")
    inputs: ClassVar = [io.Splat.Input("splat"), index]
    outputs: ClassVar = [CAPTURE.Output(display_name="capture")]

    @classmethod
    def execute(cls, splat: Any, index: int) -> Any:
        """Write it as a PLY file in ComfyUI's temporary folder."""
        if index >= len(splat.positions):
            raise ValueError(f"index={index}, and the batch has {len(splat.positions)} splats; give a smaller one")
        temporary = Path(folder_paths.get_temp_directory())
        temporary.mkdir(parents=True, exist_ok=True)
        with running():
            path = Path(mkdtemp(prefix="anystyle_", dir=temporary), "splat.ply")
            gaussians_from_splat(splat, index).save(path)
            return io.NodeOutput(path)
