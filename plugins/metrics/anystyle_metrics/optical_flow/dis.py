"""DIS: fast optical flow by dense inverse search, from OpenCV."""

from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.errors import MissingExtra, UserError
from anystyle.types import Flow, Frames
from anystyle.vision.preprocess import gray
from anystyle_metrics.optical_flow.visibility import cycle_visible

SMALLEST = 16


class DIS(Correspondence):
    """Dense inverse search (Kroeger et al., ECCV 2016), no weights; a pixel is visible if the flow back returns it.

    Needs the extra ``flow``.

    Args:
        preset: OpenCV's preset, from fast and coarse to slow and fine.
    """

    def __init__(self, *, preset: Literal["ultrafast", "fast", "medium"] = "medium") -> None:
        try:
            import cv2
        except ImportError as error:
            raise MissingExtra('correspondence=dis needs OpenCV: pip install "anystyle[flow]"') from error
        self._preset = {
            "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
            "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
            "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
        }[preset]

    def __call__(self, source: Frames, target: Frames) -> Flow:
        forward = self.displacement(source, target)
        return Flow(forward, cycle_visible(forward, self.displacement(target, source)))

    def displacement(self, source: Frames, target: Frames) -> Float[Tensor, "M 2 H W"]:
        """The flow alone, at half the cost of one with its visibility by cycle consistency."""
        height, width = source.images.shape[-2:]
        if source.images.shape != target.images.shape or min(height, width) < SMALLEST:
            raise UserError(
                f"dis got frames of {list(source.images.shape)} and {list(target.images.shape)}; it needs pairs of one "
                f"size, at least {SMALLEST} pixels a side"
            )
        import cv2

        first, second = _luma(source.images), _luma(target.images)
        # A new search for each pair: one that is reused starts from the pair before.
        # OpenCV's own types ask for a flow to start from; none is right.
        searches: list[Any] = [cv2.DISOpticalFlow.create(self._preset) for _ in first]
        flows = [search.calc(*pair, None) for search, *pair in zip(searches, first, second, strict=True)]
        return torch.from_numpy(np.stack(flows)).permute(0, 3, 1, 2).contiguous().to(source.images)


def _luma(images: Float[Tensor, "M 3 H W"]) -> UInt8[np.ndarray, "M H W"]:
    return (gray(images.clamp(0, 1), rounded=True)[:, 0] * 255).round().byte().cpu().numpy()
