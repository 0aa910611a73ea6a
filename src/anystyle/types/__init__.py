"""The values of the framework: frozen dataclasses of tensors.

Axis letters, everywhere: ``B`` scenes, ``V`` views, ``H W`` pixels, ``h w`` another image's pixels, ``P`` tokens a
view, ``C`` channels, ``N`` Gaussians, ``K`` spherical-harmonics coefficients, ``D`` style dimensions, ``M`` a flat
batch.

Conventions, everywhere: images are sRGB in [0, 1]; camera axes are OpenCV's (x right, y down, z forward); a pixel's
centre lies at +0.5; intrinsics are in pixels; ``a_from_b`` maps coordinates of b to coordinates of a.
"""

from anystyle import lazy

__getattr__, __dir__, __all__ = lazy.stub(__name__, __file__)
