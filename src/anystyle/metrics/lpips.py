"""LPIPS: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar

from anystyle.metrics._networks import LpipsMean


class LPIPS(LpipsMean):
    """LPIPS of stylized images and photographs (Zhang et al. 2018; eval_artfid.py)."""

    better: ClassVar[Mapping[str, str]] = {"lpips": "lower"}
    gray = False
