"""Styl3R as an anystyle backbone and style encoder: MASt3R's transformer for many views, and a stylizer of tokens."""

from anystyle_backbones.styl3r.backbone import Styl3r
from anystyle_backbones.styl3r.style_encoder import Styl3rStyle

__all__ = ["Styl3r", "Styl3rStyle"]
