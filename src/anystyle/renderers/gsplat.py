"""The renderer for NVIDIA graphics cards: the gsplat package."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import LinearView
from anystyle.errors import of_extra
from anystyle.geometry.harmonics import colors, degree_of
from anystyle.geometry.projection import covariances
from anystyle.renderers.rasterizer import KeptView, Rasterizer, at_least_single
from anystyle.types import Cameras, Gaussians


class GsplatRenderer(Rasterizer):
    """gsplat's CUDA kernels, all cameras of a scene at once; what the published models were trained with.

    Differentiable in the Gaussians and the poses, not in the intrinsics. The cap on alpha is compiled into gsplat:
    0.999 to version 1.5.3, 0.99 in 1.6.
    """

    devices = ("cuda",)
    priority = 10

    @classmethod
    def lacks(cls) -> str | None:
        try:
            from gsplat.cuda._backend import _C  # pyright: ignore[reportMissingImports]
        except ImportError:
            return 'is not installed: pip install "anystyle[gpu]"'
        # As it is imported, it compiles its kernels, once, or finds no compiler.
        return None if _C is not None else "cannot compile its kernels: install the CUDA toolkit, whose nvcc it runs"

    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        with torch.autocast(gaussians.means.device.type, enabled=False):
            gaussians, cameras = at_least_single(gaussians, cameras)
            # Scene by scene: later versions of gsplat take no batch of harmonics.
            images = [self._scene(gaussians, cameras, b)[0] for b in range(len(gaussians.means))]
            return torch.stack(images).to(gaussians.means.dtype)

    @torch.no_grad()
    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView | None:
        with torch.autocast(gaussians.means.device.type, enabled=False):
            image, made = self._scene(*at_least_single(gaussians, camera), 0)
        if not made:
            return None
        names = ("means2d", "conics", "opacities", "width", "height", "tile_size", "isect_offsets", "flatten_ids")
        means, conics, opacities, *places = kept = [made[name] for name in names]

        def blend(colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
            return _gsplat().rasterize_to_pixels(means, conics, colors[None], opacities, *places)[0][0].movedim(-1, 0)

        kept = [each for each in kept if isinstance(each, Tensor)]
        return KeptView(image[0], self.background, blend, gaussians.means.shape[1], kept)

    def _scene(
        self, gaussians: Gaussians, cameras: Cameras, scene: int
    ) -> tuple[Float[Tensor, "V 5 H W"], dict[str, Any]]:
        """What each view of a scene shows, and what gsplat has made of its Gaussians."""
        height, width = cameras.size
        means, rotations, scales, opacities, harmonics = (each[scene].float() for each in vars(gaussians).values())
        degree = degree_of(harmonics.shape[1])
        if len(means) == 0:
            nothing = means.new_tensor([0, 0, 0, 0, 1])[:, None, None]
            return nothing.expand(cameras.intrinsics.shape[1], 5, height, width), {}
        color, alpha, made = _gsplat().rasterization(
            means=means,
            quats=rotations,
            scales=scales,
            opacities=opacities,
            # A single coefficient is a colour that depends on no direction, which gsplat takes as RGB.
            colors=harmonics if degree else colors(harmonics, torch.zeros_like(means)),
            sh_degree=degree or None,
            viewmats=cameras.camera_from_world[scene].float(),
            Ks=cameras.intrinsics[scene].float(),
            width=width,
            height=height,
            near_plane=self.near,
            far_plane=self.far,
            eps2d=self.eps2d,
            render_mode="RGB+D",
            packed=False,
            rasterize_mode="antialiased" if gaussians.antialiased else "classic",
            # Computed here, so that quaternions of norm 0 are treated as in the other renderers.
            covars=covariances(rotations, scales),
        )
        return torch.cat([color, 1 - alpha], dim=-1).movedim(-1, 1), made


def _gsplat() -> Any:
    return of_extra("gsplat", 'the renderer "gsplat" needs', "gpu")
