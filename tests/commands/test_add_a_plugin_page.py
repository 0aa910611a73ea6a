"""docs/add_a_plugin.md: its table and its code are true; its commands are run by tests/docs/test_commands.py."""

import re
import sys
from dataclasses import fields
from pathlib import Path
from typing import get_args, get_type_hints

from anystyle import types
from anystyle.registry.catalog import base_of, kinds

PAGE = (Path(__file__).parents[2] / "docs" / "add_a_plugin.md").read_text(encoding="utf-8")


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_every_kind_is_there_with_its_contract():
    rows = dict(re.findall(r"^\| `(\w+)`(?:\\\*)? \| `([\w.]+)` \|", PAGE, re.MULTILINE))
    bases = {kind: base_of(kind) for kind in kinds()}
    paths = {kind: f"{base.__module__}.{base.__qualname__}" for kind, base in bases.items()}
    # The core's are imported from anystyle.contracts, whichever of its files holds them.
    public = {kind: re.sub(r"^anystyle\.contracts\.\w+\.", "anystyle.contracts.", path) for kind, path in paths.items()}
    assert rows == public


def test_every_field_is_there_with_its_shape():
    rows = re.findall(r"^\| `(\w+)\.(\w+)`(\??) \| `?([^|`]+?)`? \|", PAGE, re.MULTILINE)
    documented = {(cls, name): (optional == "?", shape) for cls, name, optional, shape in rows}
    for cls in (types.Tokens, types.Geometry, types.Attributes, types.Clusters, types.Gaussians):
        hints = get_type_hints(cls)
        for field in fields(cls):
            optional, shape = documented.pop((cls.__name__, field.name))
            hint = hints[field.name]
            assert optional is (type(None) in get_args(hint)), field.name
            tensor = next((one for one in (hint, *get_args(hint)) if hasattr(one, "dim_str")), None)
            assert tensor is None or tensor.dim_str == shape.strip(), field.name
    assert not documented


def test_its_own_test_passes(monkeypatch):
    # Run as written, on the class as written.
    space: dict[str, object] = {"__name__": "page"}
    monkeypatch.setitem(sys.modules, "page", type(sys)("page"))
    for text in _blocks("python"):
        if "class Sparse" in text or "def test_contract" in text:
            exec(compile(text, "add_a_plugin.md", "exec"), space)
    space["test_contract"]()
