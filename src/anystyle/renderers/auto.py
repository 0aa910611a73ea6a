"""The renderer that goes where the tensors are."""

from jaxtyping import Float
from torch import Tensor

from anystyle.registry.catalog import catalog
from anystyle.renderers._common import FASTEST, Rasterizer
from anystyle.types import Cameras, Gaussians


class AutoRenderer(Rasterizer):
    """``gsplat`` for tensors on CUDA, ``cpu`` for tensors on the CPU, ``torch`` anywhere else, decided at each call."""

    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        name = FASTEST.get(gaussians.means.device.type, "torch")
        renderer: Rasterizer = catalog().find("renderer", name).load()(**vars(self))
        return renderer.accumulate(gaussians, cameras)
