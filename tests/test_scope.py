"""The budget of ``docs/scope.md``: lines of code, kinds of plugins, commands. The bounds may fall."""

import ast
from pathlib import Path

from anystyle.__main__ import available
from anystyle.registry.catalog import kinds

ROOT = Path(__file__).parent.parent
LINES = {"src": 13_930, "plugins": 17_135, "tests": 22_160}
"""Lines of code at most; tests are those of plugins, too."""

KINDS, COMMANDS = 19, 12


def lines_of_code(path: Path) -> int:
    """Lines that are neither docstrings, comments, blank nor imports."""
    source = path.read_text(encoding="utf-8")
    skipped: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Import, ast.ImportFrom)) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        ):
            assert node.end_lineno is not None
            skipped.update(range(node.lineno, node.end_lineno + 1))
    lines = enumerate(source.splitlines(), 1)
    return sum(bool(line.strip()) and line.strip()[0] != "#" and number not in skipped for number, line in lines)


def part_of(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    return "tests" if "tests" in parts or parts[0] == "conftest.py" else parts[0]


def test_code_stays_within_its_budget():
    files = [ROOT / "conftest.py", *(path for part in LINES for path in (ROOT / part).rglob("*.py"))]
    lines = dict.fromkeys(LINES, 0)
    for path in files:
        lines[part_of(path)] += lines_of_code(path)
    assert {part: lines[part] for part in LINES if lines[part] > LINES[part]} == {}


def test_there_are_no_more_kinds_and_commands():
    assert len(kinds()) <= KINDS
    assert len(available()) <= COMMANDS
