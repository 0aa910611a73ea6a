"""Timing: seconds to stylize a scene."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._base import RowMean
from anystyle.types import Comparison


class Timing(RowMean):
    """Seconds from a style to the rendered views, averaged over scenes and styles.

    Rows whose seconds are not known are left out.

    Args:
        per_view: Divide by the number of views; the published evaluation does not.
    """

    better: ClassVar[Mapping[str, str]] = {"seconds": "lower"}

    def __init__(self, *, per_view: bool = False) -> None:
        super().__init__()
        self.per_view = per_view

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        if comparison.seconds is None:
            return torch.zeros(0, dtype=torch.float64, device=comparison.stylized.device)
        seconds = comparison.seconds.double()
        return seconds / comparison.stylized.shape[1] if self.per_view else seconds
