"""Numbers and names as people write them, in plain text, Markdown and LaTeX."""

import math
from collections.abc import Sequence

from anystyle.study.analysis import NamedResult
from anystyle.study.contract import Population

_SPECIAL_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{character: "\\" + character for character in "&%$#_{}"},
    "−": "$-$",
    "∞": r"$\infty$",
    "—": "---",
    "“": "``",
    "”": "''",
    "<": "$<$",
    ">": "$>$",
}


def p_text(pvalue: float, log10_pvalue: float | None = None) -> str:
    """A p-value with its relation sign, as one writes it: ``= 0.013``, ``= 3.5e-40``, ``< 1e-300``."""
    if math.isnan(pvalue):
        return "n/a"
    if pvalue < 1e-300:
        return "< 1e-300" if log10_pvalue is None else f"= 1e{log10_pvalue:.0f}"
    if pvalue < 1e-4:
        return f"= {pvalue:.2e}"
    if pvalue < 1e-3:
        return f"= {pvalue:.4f}"
    return f"= {pvalue:.3f}" if pvalue < 0.9995 else "= 1.000"


def plain_p(named: NamedResult) -> str:
    """A result's p-value without a relation sign, where a column's head says ``p``."""
    text = p_text(named.result.pvalue, named.result.log10_pvalue)
    return text.removeprefix("= ")


def holds_for(populations: Sequence[Population]) -> str:
    """For whom a result holds, and of what it speaks as it was shown."""
    if not populations:
        return "no one else"
    parts = []
    for population in populations:
        parts.append("sets" if population == "items" else population)
    new = "new " + (", ".join(parts[:-1]) + " and " + parts[-1] if len(parts) > 1 else parts[0])
    shared = [factor for factor in ("scenes", "styles") if factor not in populations]
    if "items" in populations:
        new += " of these scenes and styles"
    elif len(shared) == 1:
        new += f", these {shared[0]}"
    elif shared:
        new += ", these sets"
    return new if "participants" in populations else f"{new}, these participants"


def title_of(name: str) -> str:
    """A test's name for people."""
    return name.replace("_", " ")


def effect_title(name: str) -> str:
    """An effect's name for people."""
    return {"cohens_d": "Cohen's d", "rank_biserial": "rank-biserial"}.get(name, name.replace("_", " "))


def escape_tex(text: str) -> str:
    """Text that LaTeX sets as it stands."""
    return "".join(_SPECIAL_TEX.get(character, character) for character in text)


def escape_markdown(text: str) -> str:
    """Text that Markdown shows as it stands, in a cell of a table."""
    plain = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return " ".join("".join("\\" + letter if letter in "\\`*_[]|#" else letter for letter in plain).split())


def bounds(interval: tuple[float, float], digits: int = 2) -> str:
    """An interval as one writes it; a dash where there is none."""
    if math.isnan(interval[0]) or math.isnan(interval[1]):
        return "—"
    low, high = ("−∞" if end == -math.inf else "∞" if end == math.inf else f"{end:.{digits}f}" for end in interval)
    return f"[{low}, {high}]"
