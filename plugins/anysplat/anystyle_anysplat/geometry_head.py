"""Cameras and depth."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.nn.aligner import Aligner
from anystyle.nn.dpt import Dpt, by_views
from anystyle.types import Features, Geometry
from anystyle_anysplat.camera_head import CameraHead, decode_pose


class GeometryHead(contracts.GeometryHead):
    """The camera head on the last tap's camera tokens, and a DPT for depth; in the weights' precision throughout.

    Args:
        camera: Predicts pose encodings.
        depth: Predicts the logarithm of depth, and of confidence less one.
        taps: The layers that the depth head reads, four, in rising order.
        chunk: Views that the depth head decodes at a time; a matter of memory alone.
        focal_epsilon: See :func:`anystyle_anysplat.camera_head.decode_pose`.
        aligner: Computes poses from matches instead of those of the camera head, whose focal lengths are kept.
    """

    def __init__(
        self,
        *,
        camera: CameraHead,
        depth: Dpt,
        taps: Sequence[int],
        chunk: int,
        focal_epsilon: float,
        aligner: Aligner | None = None,
    ) -> None:
        super().__init__()
        self.camera = camera
        self.depth = depth
        self.taps = tuple(taps)
        self.chunk = chunk
        self.focal_epsilon = focal_epsilon
        self.aligner = aligner

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry; depth is the distance along z."""
        size = (images.shape[-2], images.shape[-1])
        last = features[self.taps[-1]].data
        with torch.autocast(last.device.type, enabled=False):
            encodings = self.camera(last[:, :, 0].to(self.camera.embed_pose.weight.dtype))
            # Here too: under autocast a product of matrices would leave poses with three digits.
            cameras = decode_pose(encodings[-1].float(), size, focal_epsilon=self.focal_epsilon)
            logs = self.log_depth(features, size)
        depth, confidence = logs.float().exp().unbind(2)
        geometry = Geometry(cameras=cameras, depth=depth, confidence=1 + confidence)
        if self.aligner is None:
            return geometry
        return self.aligner.aligned(geometry, images, features[self.taps[-1]].reference)

    def log_depth(self, features: Features, size: tuple[int, int]) -> Float[Tensor, "B V 2 H W"]:
        """The depth head's two maps, before the exponential."""
        tokens = [features[layer] for layer in self.taps]
        batch, views = tokens[0].data.shape[:2]

        def decode_chunk(chosen: slice) -> Tensor:
            levels = [self.depth.norm(level.patches[:, chosen].to(self.depth.dtype)).flatten(0, 1) for level in tokens]
            return self.depth.predict_(self.depth.decode(levels, tokens[0].grid, size)).unflatten(0, (batch, -1))

        return by_views(decode_chunk, views, max(1, self.chunk // batch)).movedim(-1, 2)
