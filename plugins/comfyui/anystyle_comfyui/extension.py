"""The list of nodes that ComfyUI shows."""

import importlib
from typing import Any

from .nodes import Node

api: Any = importlib.import_module("comfy_api.latest")


class AnyStyleExtension(api.ComfyExtension):
    """All nodes; those of the type ``SPLAT`` where this ComfyUI has it."""

    async def get_node_list(self) -> list[type]:
        """The nodes, in the order of work."""
        if "Splat" in dir(api.io):
            importlib.import_module(".splat_nodes", __package__)
        return Node.__subclasses__()
