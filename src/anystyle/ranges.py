"""Numbers within a range, as annotations of options and of fields of files: ``Annotated[int, Range(ge=2)]``."""

from typing import Annotated

from msgspec import Meta as Range

from anystyle.errors import UserError

__all__ = ["AtLeastOne", "Count", "Fraction", "NonNegative", "Positive", "Range", "Share", "checked_seed"]

AtLeastOne = Annotated[int, Range(ge=1)]
Count = Annotated[int, Range(ge=0)]
Positive = Annotated[float, Range(gt=0)]
NonNegative = Annotated[float, Range(ge=0)]
Fraction = Annotated[float, Range(ge=0, le=1)]
Share = Annotated[float, Range(gt=0, le=1)]
"""A fraction that is not 0."""


def checked_seed(seed: object) -> int:
    """The configured seed."""
    if not isinstance(seed, int) or not 0 <= seed < 1 << 63:
        raise UserError(f"seed={seed}; give an integer of at least 0")
    return seed
