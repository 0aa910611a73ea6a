"""Cameras, depth and rays."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.errors import UserError
from anystyle.nn.aligner import Aligner
from anystyle.nn.dpt import Chain, Dpt, add_positions_
from anystyle.nn.heads import DptGeometry
from anystyle.types import Cameras, Features
from anystyle_depth_anything.cameras import CameraDecoder, decode_pose

HIDDEN = 32
"""Channels of decoders' last hidden layers, in every size."""


class RayChain(nn.Module):
    """Predicts a ray at each of 8 x 8 points a patch."""

    def __init__(self, features: int) -> None:
        super().__init__()
        wide, narrow = features, features // 2
        self.fusions = Chain(wide, rectified=False)
        self.neck = nn.Sequential(
            *(nn.Conv2d(a, b, 3, padding=1) for a, b in [(wide, narrow), (narrow, wide)] * 2 + [(wide, narrow)])
        )
        self.first = nn.Conv2d(narrow, HIDDEN, 3, padding=1)
        self.norm = nn.LayerNorm(HIDDEN)
        self.last = nn.Conv2d(HIDDEN, 7, 1)

    def forward(self, maps: Sequence[Float[Tensor, "M C _ _"]]) -> Float[Tensor, "M 7 h w"]:
        """Direction and origin of rays, and the logarithm of confidence less one."""
        x = self.neck(self.fusions(maps))
        x = self.first(add_positions_(x, x.shape[-1] / x.shape[-2]))
        return self.last(F.relu(self.norm(x.movedim(1, -1)).movedim(-1, 1)))


class GeometryHead(DptGeometry, contracts.GeometryHead):
    """The camera decoder and the dual decoder for depth and rays; see :class:`anystyle.nn.heads.DptGeometry`."""

    def __init__(
        self,
        *,
        dim: int,
        features: int,
        channels: Sequence[int],
        rays: bool,
        taps: Sequence[int],
        chunk: int,
        aligner: Aligner | None = None,
    ) -> None:
        camera = CameraDecoder(dim)
        depth = Dpt(dim=dim, features=features, channels=channels, hidden=HIDDEN, outputs=2, rectified=False)
        ray = RayChain(features) if rays else None
        super().__init__(depth, taps=taps, chunk=chunk, aligner=aligner)
        self.camera, self.ray = camera, ray

    def cameras(self, tokens: Float[Tensor, "B V C"], size: tuple[int, int]) -> Cameras:
        return decode_pose(self.camera(tokens).float(), size)

    def rays(self, features: Features) -> tuple[Float[Tensor, "B V h w 6"], Float[Tensor, "B V h w"]]:
        """Direction and origin of a ray at each of 8 x 8 points a patch, and its confidence."""
        chain = self.ray
        if chain is None:
            raise UserError("this network predicts no rays; set rays=true")
        last = features[self.taps[-1]]
        with torch.autocast(last.data.device.type, enabled=False):
            aspect = last.grid[1] / last.grid[0]
            raw = self.decode(features, lambda levels: chain(self.depth.levels(levels, last.grid, aspect)))
        raw = raw.movedim(2, -1).float()  # B V h w 7
        return raw[..., :6], 1 + raw[..., 6].exp()
