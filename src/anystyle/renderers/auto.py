"""The renderer that goes where the tensors are."""

from anystyle.contracts import Renderer
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, Renders

FASTEST = {"cuda": "gsplat", "cpu": "cpu"}
"""The renderer for a type of device; ``torch`` runs on all others."""


class AutoRenderer(Renderer):
    """``gsplat`` for tensors on CUDA, ``cpu`` for tensors on the CPU, ``torch`` anywhere else, decided at each call.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are not seen; the published renderer's default.
        far: Distance along z over which centres are not seen.
        eps2d: Low-pass filter of a pixel: variance in pixels² added to every Gaussian in the image.
    """

    def __init__(
        self,
        *,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        near: float = 1e-10,
        far: float = 1e10,
        eps2d: float = 0.3,
    ) -> None:
        self.options = {"background": background, "near": near, "far": far, "eps2d": eps2d}

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene with the renderer for the Gaussians' device.

        Raises:
            ImportError: The tensors are on CUDA and gsplat is not installed.
        """
        name = FASTEST.get(gaussians.means.device.type, "torch")
        renderer: Renderer = catalog().find("renderer", name).load()(**self.options)
        return renderer(gaussians, cameras)
