"""The templates of pages and pictures."""

from pathlib import Path
from typing import TYPE_CHECKING

from anystyle.evaluation.tables import number

if TYPE_CHECKING:
    from jinja2 import Environment

PAGES = Path(__file__).parent / "pages"


def templates() -> "Environment":
    """Templates by the names of their files, with what all of them use."""
    from jinja2 import Environment, FileSystemLoader

    environment = Environment(loader=FileSystemLoader(PAGES), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.tests["address"] = lambda text: text.startswith(("https://", "http://"))
    environment.filters["number"] = number
    return environment
