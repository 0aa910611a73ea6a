"""docs/add_a_plugin.md: its table and its code are true; its commands are run by tests/docs/test_commands.py."""

import re
import sys
from pathlib import Path

from anystyle.registry.catalog import base_of, kinds

PAGE = (Path(__file__).parents[2] / "docs" / "add_a_plugin.md").read_text(encoding="utf-8")


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_every_kind_is_there_with_its_contract():
    rows = dict(re.findall(r"^\| `(\w+)`(?:\\\*)? \| `([\w.]+)` \|", PAGE, re.MULTILINE))
    bases = {kind: base_of(kind) for kind in kinds()}
    assert rows == {kind: f"{base.__module__}.{base.__qualname__}" for kind, base in bases.items()}


def test_its_own_test_passes(monkeypatch):
    # Run as written, on the class as written.
    space: dict[str, object] = {"__name__": "page"}
    monkeypatch.setitem(sys.modules, "page", type(sys)("page"))
    for text in _blocks("python"):
        if "class Sparse" in text or "def test_contract" in text:
            exec(compile(text, "add_a_plugin.md", "exec"), space)
    space["test_contract"]()
