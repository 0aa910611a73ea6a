"""Names of files, in the order in which people count."""

import re


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts ``view2`` before ``view10``."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name.casefold()) if part]
