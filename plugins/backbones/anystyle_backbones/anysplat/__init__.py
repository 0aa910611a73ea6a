"""AnySplat as an anystyle backbone: VGGT's transformer with heads for cameras, depth and Gaussians."""

from anystyle_backbones.anysplat.backbone import AnySplat

__all__ = ["AnySplat"]
