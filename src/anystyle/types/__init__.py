"""The values of the framework: frozen dataclasses of tensors.

Axis letters, everywhere: ``B`` scenes, ``V`` views, ``H W`` pixels, ``h w`` another image's pixels, ``P`` tokens a
view, ``C`` channels, ``N`` Gaussians, ``K`` spherical-harmonics coefficients, ``D`` style dimensions, ``M`` a flat
batch.

Conventions, everywhere: images are sRGB in [0, 1]; camera axes are OpenCV's (x right, y down, z forward); a pixel's
centre lies at +0.5; intrinsics are in pixels; ``a_from_b`` maps coordinates of b to coordinates of a.
"""

from anystyle.types.comparison import Comparison, Flow, Frames, Stylization
from anystyle.types.network import (
    Attributes,
    Features,
    Geometry,
    Inject,
    Site,
    Source,
    StyleEmbedding,
    Tokens,
    contiguous,
    matching_sites,
    untouched,
)
from anystyle.types.progress import OnProgress, Progress, no_progress
from anystyle.types.scene import Clusters, Gaussians, Reconstructed, Renders, Scene, StyledScene
from anystyle.types.shapes import Value
from anystyle.types.views import Cameras, Original, SourceImage, Style, TextMatch, Views

__all__ = [
    "Attributes",
    "Cameras",
    "Clusters",
    "Comparison",
    "Features",
    "Flow",
    "Frames",
    "Gaussians",
    "Geometry",
    "Inject",
    "OnProgress",
    "Original",
    "Progress",
    "Reconstructed",
    "Renders",
    "Scene",
    "Site",
    "Source",
    "SourceImage",
    "Style",
    "StyleEmbedding",
    "StyledScene",
    "Stylization",
    "TextMatch",
    "Tokens",
    "Value",
    "Views",
    "contiguous",
    "matching_sites",
    "no_progress",
    "untouched",
]
