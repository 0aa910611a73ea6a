"""Stylos as an anystyle backbone: AnySplat's geometry, and colours that attend to the tokens of a style image."""

from anystyle_backbones.stylos.backbone import Stylos
from anystyle_backbones.stylos.style_encoder import StylosStyle

__all__ = ["Stylos", "StylosStyle"]
