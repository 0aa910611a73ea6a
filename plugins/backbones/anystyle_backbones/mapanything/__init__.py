"""MapAnything as an anystyle backbone: metric points and cameras from DINOv2's tokens, and a head for Gaussians."""

from anystyle_backbones.mapanything.backbone import MapAnything

__all__ = ["MapAnything"]
