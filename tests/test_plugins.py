"""The packages of ``plugins/`` take the road of a third party, and the docs list them."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECTS = {
    file.parent.name: tomllib.loads(file.read_text())["project"] for file in ROOT.glob("plugins/*/pyproject.toml")
}


def test_the_design_lists_each_package():
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/design.md").read_text().partition("Beside `src/`")[2], re.M)
    assert sorted(listed) == sorted(PROJECTS)


@pytest.mark.parametrize("folder", sorted(PROJECTS))
def test_the_list_of_packages_has_its_kinds(folder):
    project = PROJECTS[folder]
    rows = [
        line for line in (ROOT / "docs/third_party.md").read_text().splitlines() if f"(../plugins/{folder}/" in line
    ]
    assert len(rows) == 1 and rows[0].startswith(f"| `{project['name']}` |")
    kinds = {group.removeprefix("anystyle.") for group in project.get("entry-points", {})} - {"kind"}
    assert set(re.findall(r"`(\w+)`", rows[0].split("|")[2].partition(";")[0])) == kinds


@pytest.mark.parametrize("folder", sorted(PROJECTS))
def test_a_package_imports_other_packages_only_if_it_depends_on_them(folder):
    """Private modules of the core are forbidden, too; .importlinter forbids those of commands."""
    declared = {re.split(r"[^\w-]", line)[0].replace("-", "_") for line in PROJECTS[folder]["dependencies"]}
    found = set()
    for file in (ROOT / "plugins" / folder / f"anystyle_{folder}").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                assert not re.search(r"^anystyle\.(.*\.)?_", module), f"{file.name} imports {module}"
                if module.startswith("anystyle_"):
                    found.add(module.partition(".")[0])
    assert found - {f"anystyle_{folder}"} <= declared
