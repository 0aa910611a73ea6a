"""The list of nodes that ComfyUI shows."""

import importlib
from typing import Any

from . import nodes

api: Any = importlib.import_module("comfy_api.latest")


class AnyStyleExtension(api.ComfyExtension):
    """All nodes; those of the type ``SPLAT`` where this ComfyUI has it."""

    async def get_node_list(self) -> list[type]:
        """The nodes, in the order of work."""
        found: list[type] = [
            nodes.LoadModel,
            nodes.LoadCapture,
            nodes.FitScene,
            nodes.TextStyle,
            nodes.ImageStyle,
            nodes.MixStyles,
            nodes.Stylize,
            nodes.Render,
            nodes.SaveScene,
        ]
        if "Splat" in dir(api.io):
            from .splat_nodes import CaptureFromSplat, SceneToSplat

            found += [SceneToSplat, CaptureFromSplat]
        return found
