"""Timing: seconds to stylize a scene."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import RowMean
from anystyle.types import Comparison


class Timing(RowMean):
    """Seconds from a style to the rendered views, averaged over scenes and styles; rows without them are left out.

    Example:
        >>> images, metric = torch.zeros(2, 3, 8, 8), Timing()
        >>> metric.update(images, seconds=torch.tensor([1.0, 2.0]))
        >>> metric.compute()
        tensor(1.5000)
    """

    better: ClassVar[Mapping[str, str]] = {"seconds": "lower"}
    takes = ("preds", "seconds")

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        if comparison.seconds is None:
            return torch.zeros(0, dtype=torch.float64, device=comparison.stylized.device)
        return comparison.seconds.double()
