"""Nodes for ComfyUI: photographs and styles in, Gaussian scenes and renders out."""

from typing import Any

__all__ = ["comfy_entrypoint"]


async def comfy_entrypoint() -> Any:
    """The extension, which ComfyUI asks for when it starts."""
    from .extension import AnyStyleExtension  # importable only where ComfyUI runs

    return AnyStyleExtension()
