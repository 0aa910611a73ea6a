"""Which Gaussians each tile of an image shows, and launches of the kernels that blend them."""

import os
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import torch
from jaxtyping import Float, Int32
from torch import Tensor

from anystyle.errors import of_extra
from anystyle.geometry.projection import ProjectedGaussians

TILE = 8


@cache
def imported() -> ModuleType:
    """The package ``warp``, ready to compile.

    Raises:
        MissingExtra: It is not installed.
    """
    warp = of_extra("warp", 'the renderer "warp" needs', "warp")
    warp.config.log_level = warp.LOG_WARNING  # otherwise it greets, and tells of every kernel that it compiles
    shown, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        if not torch.cuda.is_available():  # it would warn that there is no driver
            os.dup2(nowhere, 2)
        warp.init()
    finally:
        os.dup2(shown, 2)
        os.close(shown)
        os.close(nowhere)
    return warp


@dataclass(frozen=True, eq=False)
class TileLists:
    """The Gaussians that each tile of one view shows.

    Args:
        entries: Gaussians, by tiles from left to right and top to bottom, and in each nearest first.
        starts: The first entry of each tile, and one past the last of all.
        size: Height and width of the image in pixels.
        cap: The largest alpha of one Gaussian in a pixel.
    """

    entries: Int32[Tensor, " m"]
    starts: Int32[Tensor, " t"]
    size: tuple[int, int]
    cap: float

    @classmethod
    @torch.no_grad()
    def of(cls, splats: ProjectedGaussians, size: tuple[int, int], cap: float) -> "TileLists":
        """The tiles that the rectangle around each Gaussian of a view touches; read back is how many there are."""
        rows, columns = (-(-side // TILE) for side in size)
        largest = splats.means.new_tensor([columns - 1, rows - 1])
        low, high = (
            (edge / TILE).floor().clamp_min(0).minimum(largest).long()
            for edge in (splats.means - splats.radii, splats.means + splats.radii)
        )  # n 2
        wide, tall = (high - low + 1).unbind(1)
        counts = wide * tall
        owners = torch.arange(len(counts), device=counts.device).repeat_interleave(counts)  # m
        place = torch.arange(len(owners), device=counts.device) - (counts.cumsum(0) - counts)[owners]
        down, right = place // wide[owners], place % wide[owners]
        tile = ((low[owners, 1] + down) * columns + low[owners, 0] + right).int()
        tile, order = tile.sort(stable=True)
        every = torch.arange(rows * columns + 1, device=tile.device, dtype=tile.dtype)
        return cls(owners[order].int(), torch.searchsorted(tile, every, out_int32=True), size, cap)

    def blend(
        self, shapes: Float[Tensor, "n 6"], payload: Float[Tensor, "n 4"]
    ) -> tuple[Float[Tensor, "5 H W"], Int32[Tensor, "H W"]]:
        """The payload over black with the transmittance, and the last entry that each pixel blended.

        Args:
            shapes: Position x, y, inverse covariance xx, xy, yy, and opacity of each Gaussian.
            payload: Red, green, blue and depth of each.
        """
        image, last = shapes.new_empty(5, *self.size), self.entries.new_empty(self.size)
        self._launch("blend", shapes, payload, image, last)
        return image, last

    def backward(
        self,
        shapes: Float[Tensor, "n 6"],
        payload: Float[Tensor, "n 4"],
        image: Float[Tensor, "5 H W"],
        last: Int32[Tensor, "H W"],
        d_image: Float[Tensor, "5 H W"],
    ) -> tuple[Float[Tensor, "n 6"], Float[Tensor, "n 4"]]:
        """The gradients of shapes and payload, given that of the image that :meth:`blend` returned."""
        grads = torch.zeros_like(shapes), torch.zeros_like(payload)
        self._launch("blend_backward", shapes, payload, image, last, d_image.contiguous(), *grads)
        return grads

    def _launch(self, name: str, *tensors: Tensor) -> None:
        """Run a kernel, a block of threads per tile, on PyTorch's current stream."""
        warp = imported()
        from anystyle_warp_renderer import kernels

        def array(tensor: Tensor) -> Any:
            kind = {4: warp.vec4, 6: kernels.Shape}.get(tensor.shape[1]) if tensor.ndim == 2 else None
            return warp.from_torch(tensor.detach(), kind if tensor.is_floating_point() else None, requires_grad=False)

        shapes, payload, *images = map(array, tensors)
        device = self.entries.device
        warp.launch(
            getattr(kernels, name),
            dim=(len(self.starts) - 1, TILE * TILE),
            inputs=[shapes, payload, array(self.entries), array(self.starts), self.cap, *images],
            device=warp.device_from_torch(device),
            stream=warp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None,
            block_dim=TILE * TILE,
        )
