"""WorldMirror as an anystyle backbone: VGGT's transformer, and Gaussians with a depth and colours of their own."""

from anystyle_backbones.worldmirror.backbone import WorldMirror

__all__ = ["WorldMirror"]
