"""LPIPS without colour: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar

from anystyle.metrics._networks import LpipsMean


class LPIPSGray(LpipsMean):
    """LPIPS of stylized images and photographs, both without colour, so that a palette costs nothing."""

    better: ClassVar[Mapping[str, str]] = {"lpips_gray": "lower"}
    gray = True
