"""Cameras and depth."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.nn.aligner import Aligner
from anystyle.nn.dpt import Dpt
from anystyle.nn.heads import DptGeometry
from anystyle.types import Cameras
from anystyle_anysplat.camera_head import CameraHead, decode_pose


class GeometryHead(DptGeometry, contracts.GeometryHead):
    """The camera head and a DPT for depth; see :class:`anystyle.nn.heads.DptGeometry`."""

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
        super().__init__(depth, taps=taps, chunk=chunk, aligner=aligner)
        self.camera = camera
        self.focal_epsilon = focal_epsilon

    def cameras(self, tokens: Float[Tensor, "B V C"], size: tuple[int, int]) -> Cameras:
        return decode_pose(self.camera(tokens)[-1].float(), size, focal_epsilon=self.focal_epsilon)
