"""The folder as ComfyUI loads it from ``custom_nodes``."""

from .anystyle_comfyui import comfy_entrypoint

__all__ = ["comfy_entrypoint"]
