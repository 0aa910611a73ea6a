"""LaTeX of a table whose decimal points and signs ± stand below each other."""

import re
from collections.abc import Sequence

from anystyle.evaluation.tables import Table

_NEEDS = r"% Needs \usepackage{booktabs}, and amssymb for ✓; phantom digits align the numbers."
_CELL = re.compile(r"(\\\w+\{)?(?:\$-\$)?\d+(\.\d+)?(\})?(?: \$\\pm\$ (\d+)(\.\d+)?)?")
"""A number as it is written in LaTeX, perhaps marked, perhaps with the half-width of its interval."""


def aligned(table: Table) -> str:
    """The table as LaTeX that needs ``booktabs``."""
    head, rest = table.latex().split("\\midrule\n")
    body, foot = rest.split("\\bottomrule\n")
    rows = [line.removesuffix(r" \\").split(" & ") for line in body.splitlines()]
    columns = [_column(cells) for cells in zip(*rows, strict=True)]
    lines = [" & ".join(cells) + r" \\" for cells in zip(*columns, strict=True)]
    return "\n".join([_NEEDS, f"{head}\\midrule", *lines, f"\\bottomrule\n{foot}"])


def _column(cells: Sequence[str]) -> list[str]:
    """Cells of one column: what a number lacks to the longest parts of all is left free."""
    found = [_CELL.fullmatch(cell) for cell in cells]
    parts = ([match[part] or "" for match in found if match] for part in (2, 4, 5))
    decimals, whole, half = (re.sub(r"\d", "0", max(part, key=len, default="")) for part in parts)

    def padded(cell: str, match: re.Match[str] | None) -> str:
        if match is None:
            return cell
        number, _, interval = cell.partition(r" $\pm$ ")
        number += _phantom(decimals, match[2])
        if interval:
            return rf"{number} $\pm$ {_phantom(whole, match[4])}{interval}{_phantom(half, match[5])}"
        return number + (rf"\phantom{{ $\pm$ {whole}{half}}}" if whole else "")

    return [padded(cell, match) for cell, match in zip(cells, found, strict=True)]


def _phantom(longest: str, own: str | None) -> str:
    """The characters of the longest part that its own lacks, invisible."""
    lacking = longest[len(own or "") :] if longest.startswith(".") else longest[: len(longest) - len(own or "")]
    return rf"\phantom{{{lacking}}}" if lacking else ""
