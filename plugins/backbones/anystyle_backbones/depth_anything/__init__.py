"""Depth Anything 3 as an anystyle backbone: one transformer whose later blocks alternate, and its heads."""

from anystyle_backbones.depth_anything.backbone import DepthAnything

__all__ = ["DepthAnything"]
