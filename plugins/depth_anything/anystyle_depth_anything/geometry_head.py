"""Cameras, depth and rays."""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.aligner import Aligner
from anystyle.nn.dpt import Chain, Dpt, add_positions_, by_views
from anystyle.types import Features, Geometry
from anystyle_depth_anything.cameras import CameraDecoder, decode_pose

HIDDEN = 32
"""Channels of decoders' last hidden layers, in every size."""


class RayChain(nn.Module):
    """Tells the ray of every place on a grid eight times as fine as the patches."""

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


class GeometryHead(contracts.GeometryHead):
    """The camera decoder on the last tap's camera tokens, and the dual decoder; in the weights' precision throughout.

    Args:
        dim: Channels of the tokens.
        features: Channels of the decoder.
        channels: Channels of its four levels.
        rays: Whether it has the chain that tells rays, which :meth:`rays` alone computes.
        taps: The layers that the decoder reads, four, in rising order.
        chunk: Views decoded at a time; a matter of memory alone.
        aligner: Computes poses from matches instead of those of the camera decoder, whose focal lengths are kept.
    """

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
        super().__init__()
        self.camera = CameraDecoder(dim)
        self.depth = Dpt(dim=dim, features=features, channels=channels, hidden=HIDDEN, outputs=2, rectified=False)
        self.ray = RayChain(features) if rays else None
        self.taps = tuple(taps)
        self.chunk = chunk
        self.aligner = aligner

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry; depth is the distance along z."""
        size = (images.shape[-2], images.shape[-1])
        grid, last = features[self.taps[-1]].grid, features[self.taps[-1]].data
        with torch.autocast(last.device.type, enabled=False):
            encodings = self.camera(last[:, :, 0].to(self.depth.dtype))
            # Here too: under autocast a product of matrices would leave poses with three digits.
            cameras = decode_pose(encodings.float(), size)
            logs = self._by_views(
                features, lambda levels: self.depth.predict_(self.depth.decode(levels, grid, size))
            )  # B V H W 2
        depth, confidence = logs.float().exp().unbind(-1)
        geometry = Geometry(cameras=cameras, depth=depth, confidence=1 + confidence)
        if self.aligner is None:
            return geometry
        return self.aligner.aligned(geometry, images, features[self.taps[-1]].reference)

    def rays(self, features: Features) -> tuple[Float[Tensor, "B V h w 6"], Float[Tensor, "B V h w"]]:
        """Direction and origin of the ray of every place, eight to a patch's side, and their confidence.

        Raises:
            ValueError: The network has no chain for rays.
        """
        chain = self.ray
        if chain is None:
            raise ValueError("this network tells no rays; set rays=true")
        grid = features[self.taps[-1]].grid
        with torch.autocast(features[self.taps[-1]].data.device.type, enabled=False):
            raw = self._by_views(
                features, lambda levels: chain(self.depth.levels(levels, grid, grid[1] / grid[0]))
            )  # B V 7 h w
        raw = raw.movedim(2, -1).float()
        return raw[..., :6], 1 + raw[..., 6].exp()

    def _by_views(self, features: Features, decode: Callable[[list[Tensor]], Tensor]) -> Float[Tensor, "B V *rest"]:
        tokens = [features[layer] for layer in self.taps]
        batch, views = tokens[0].data.shape[:2]

        def decode_chunk(chosen: slice) -> Tensor:
            patches = (level.patches[:, chosen].to(self.depth.dtype) for level in tokens)
            return decode([self.depth.norm(level).flatten(0, 1) for level in patches]).unflatten(0, (batch, -1))

        return by_views(decode_chunk, views, max(1, self.chunk // batch))
