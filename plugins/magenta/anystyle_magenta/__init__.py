"""Magenta's arbitrary image stylization: a style encoder, an injector for colours of pixels, and its use in 2D."""

from anystyle_magenta.injector import MagentaInjector, stylize_images
from anystyle_magenta.style_encoder import MagentaEncoder

__all__ = ["MagentaEncoder", "MagentaInjector", "stylize_images"]
