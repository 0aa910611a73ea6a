"""Numbers within a range, as annotations of options and of fields of files: ``Annotated[int, Range(ge=2)]``."""

from typing import Annotated

from msgspec import Meta as Range

__all__ = ["AtLeastOne", "Count", "Fraction", "NonNegative", "Positive", "Range", "Share"]

AtLeastOne = Annotated[int, Range(ge=1)]
Count = Annotated[int, Range(ge=0)]
Positive = Annotated[float, Range(gt=0)]
NonNegative = Annotated[float, Range(ge=0)]
Fraction = Annotated[float, Range(ge=0, le=1)]
Share = Annotated[float, Range(gt=0, le=1)]
"""A fraction that is not 0."""
