"""Magenta's arbitrary image stylization: a style encoder, an injector for colours of pixels, and its use in 2D."""

from anystyle_magenta.injector import MagentaInjector
from anystyle_magenta.style_encoder import MagentaEncoder
from anystyle_magenta.stylize import stylize_images

__all__ = ["MagentaEncoder", "MagentaInjector", "stylize_images"]
