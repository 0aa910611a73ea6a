"""The renderer for cards without a compiler: PyTorch projects and sorts, kernels of NVIDIA's Warp blend."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import pad

from anystyle.contracts import LinearView
from anystyle.errors import MissingExtra
from anystyle.geometry.projection import ProjectedGaussians
from anystyle.renderers.rasterizer import KeptView, at_least_single
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians
from anystyle_warp_renderer.tiles import TileLists, imported


@dataclass(kw_only=True, eq=False)
class WarpRenderer(TorchRenderer):
    """The reference renderer with compiled tiles: for a card without gsplat, nvcc or a C compiler.

    Blends in single precision on the tensors' device; once differentiable in the Gaussians, the poses and the
    intrinsics. On CUDA, gradients are sums in no fixed order.
    """

    devices = ("cpu", "cuda")
    priority = 10

    def __post_init__(self) -> None:
        imported()

    @classmethod
    def lacks(cls) -> str | None:
        try:
            sees_card = imported().is_cuda_available()
        except MissingExtra:
            return 'is not installed: pip install "anystyle[warp]"'
        older = torch.cuda.is_available() and not sees_card
        return "needs a newer driver of the card: R580, for CUDA 13" if older else None

    def blend_view(
        self, splats: ProjectedGaussians, payload: Float[Tensor, "n 4"], size: tuple[int, int]
    ) -> Float[Tensor, "5 H W"]:
        image = _Blending.apply(_shapes(splats), payload.float(), TileLists.of(splats, size, self.alpha_cap))
        assert isinstance(image, Tensor)
        return image.to(payload.dtype)

    @torch.no_grad()
    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView:
        with torch.autocast(gaussians.means.device.type, enabled=False):
            splats, payload = self.project_view(*at_least_single(gaussians, camera), 0, 0)
            tiles = TileLists.of(splats, camera.size, self.alpha_cap)
        shapes = _shapes(splats)

        def blend(colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
            return _Blending.apply(shapes, pad(colors.index_select(0, splats.index), (0, 1)), tiles)[:3]

        image, number = _Blending.apply(shapes, payload.float(), tiles), gaussians.means.shape[1]
        kept = shapes, splats.index, tiles.entries, tiles.starts, payload
        return KeptView(image, self.background, blend, number, kept)


class _Blending(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, shapes: Tensor, payload: Tensor, tiles: TileLists) -> Tensor:
        image, last = tiles.blend(shapes, payload)
        ctx.save_for_backward(shapes, payload, image, last)
        ctx.tiles = tiles
        return image

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor, Tensor, None]:
        return *ctx.tiles.backward(*ctx.saved_tensors, grad_outputs[0]), None


def _shapes(splats: ProjectedGaussians) -> Float[Tensor, "n 6"]:
    return torch.cat([splats.means, splats.conics, splats.opacities[:, None]], dim=-1).float()
