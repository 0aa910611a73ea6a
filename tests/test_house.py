"""The house rules, executable.

The public surface is written down in ``surface.json``: the catalog's names, the built-in plugins' options and what
``anystyle`` exports. A change that is meant is written down by ``python tests/test_house.py`` and told in the
changelog.
"""

import ast
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import anystyle
from anystyle import paths
from anystyle.commands.plugins import arguments
from anystyle.registry import packages
from anystyle.registry.builtin import BUILTIN, KINDS
from anystyle.registry.catalog import Plugin, base_of, catalog, kinds
from anystyle.registry.compose import compose
from anystyle.registry.schema import options, shown

ROOT = Path(__file__).parent.parent
SURFACE = Path(__file__).parent / "surface.json"
SOURCES = sorted(paths.PACKAGE.rglob("*.py"))
SHIPPED = [*SOURCES, *sorted(path for path in paths.PLUGINS.rglob("*.py") if "tests" not in path.parts)]
TEXTS = [
    path
    for folder in (paths.PACKAGE, paths.PLUGINS, paths.CONF, ROOT / "docs", ROOT / "notebooks")
    for path in sorted(folder.rglob("*"))
    if path.suffix in (".py", ".toml", ".yaml", ".md", ".ipynb", ".json", ".cff")
] + sorted(ROOT.glob("*.md"))


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(ast.parse(path.read_bytes(), str(path))))


def nodes(*kinds: type[ast.AST]) -> Iterator[tuple[Path, ast.AST]]:
    """Every node of some kinds, with its file."""
    for path in SHIPPED:
        for node in nodes_of(path):
            if isinstance(node, kinds):
                yield path, node


def place(path: Path, node: ast.AST) -> str:
    return f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"


def calls(name: str) -> Iterator[tuple[Path, ast.Call]]:
    """Calls of a function or method by its last name."""
    for path, node in nodes(ast.Call):
        assert isinstance(node, ast.Call)
        function = node.func
        if name == (function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", None)):
            yield path, node


def test_print_belongs_to_commands():
    """And to what commands run for people to read: the checks of contracts."""
    found = [path for path, _ in calls("print") if not {"cli", "commands", "testing"} & {*path.parts}]
    assert [path for path in found if not path.name.startswith("command")] == []


def test_no_device_is_written_down():
    found = [place(path, node) for path, node in calls("cuda")]
    for path, node in calls("to"):
        values = [argument.value for argument in node.args if isinstance(argument, ast.Constant)]
        found += [place(path, node) for value in values if str(value).startswith("cuda")]
    assert found == []


def test_loading_is_strict():
    found = [
        place(path, node)
        for path, node in nodes(ast.Call)
        if getattr(node.func, "id", None) != "zip"  # which has another "strict"
        and any(each.arg == "strict" and getattr(each.value, "value", None) is False for each in node.keywords)
    ]
    assert found == []


def test_untrusted_files_are_data():
    found = [
        place(path, node) for name in ("eval", "exec") for path, node in calls(name) if isinstance(node.func, ast.Name)
    ]
    for name in ("load", "loads", "Unpickler"):
        for path, node in calls(name):
            owner = getattr(node.func.value, "id", None) if isinstance(node.func, ast.Attribute) else None
            flags = {keyword.arg: getattr(keyword.value, "value", None) for keyword in node.keywords}
            # Contracts send what they just made through pickle, as worker processes do.
            pickled = owner in ("pickle", "marshal", "dill", "cloudpickle") and "testing" not in path.parts
            if pickled or (owner == "torch" and flags.get("weights_only") is not True):
                found.append(place(path, node))
    assert found == []


def test_annotations_are_evaluated():
    assert [place(path, node) for path, node in nodes(ast.ImportFrom) if node.module == "__future__"] == []


def test_no_duck_is_probed():
    assert [place(path, node) for path, node in calls("hasattr")] == []


def test_packages_are_packages():
    folders = {path.parent for path in SOURCES}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_a_name_means_one_thing():
    """No class has the name of another, but for a part that has the name of its contract, and no alias that of a class.

    In the framework and the packages that its users need; programs built on it have words of their own.
    """
    programs = {paths.PLUGINS / name for name in ("benchmark",)}
    meanings: defaultdict[str, dict[str, str]] = defaultdict(dict)
    for path in SHIPPED:
        if programs & {*path.parents}:
            continue
        for node in nodes_of(path):
            if isinstance(node, ast.ClassDef):
                if f"contracts.{node.name}" not in map(ast.unparse, node.bases):
                    meanings[node.name][place(path, node)] = "a class"
            elif isinstance(node, ast.Assign) and re.match("[A-Z][a-z]", name := ast.unparse(node.targets[0])):
                meanings[name].setdefault(place(path, node), ast.unparse(node.value))
    found = {
        name: places
        for name, places in meanings.items()
        if len(places) > 1 and ("a class" in places.values() or len({*places.values()}) > 1)
    }
    assert found == {}


def shipped() -> list[Plugin]:
    """The built-in plugins, and those of the folders that come with the package."""
    local = [row for row in catalog() if row.root is not None and row.root.is_relative_to(paths.PLUGINS)]
    return [row for row in catalog() if row.origin == "anystyle"] + local


def test_siblings_never_import_each_other():
    graph = grimp.build_graph("anystyle", cache_dir=None)
    modules = defaultdict(set)
    for kind, rows in BUILTIN.items():
        modules[kind] = {target.partition(":")[0] for target in rows.values()}
    found = [
        (one, other)
        for siblings in modules.values()
        for one in siblings
        for other in graph.find_modules_directly_imported_by(one)
        if other in siblings and other != one
    ]
    assert found == []


def test_no_code_names_a_plugin_package():
    """No text and no import of the core names a package of ``plugins/`` or a backbone; docstrings may."""
    packages = {f"anystyle_{folder.name}" for folder in paths.PLUGINS.iterdir() if folder.is_dir()}
    words = re.compile(rf"(?<![a-z])({'|'.join(sorted(packages | set(catalog().names('backbone'))))})(?![a-z])", re.I)
    found = []
    for path in SOURCES:
        documentation = {id(node.value) for node in nodes_of(path) if isinstance(node, ast.Expr)}
        for node in nodes_of(path):
            texts = [getattr(node, field, None) for field in ("id", "attr", "arg", "name", "module", "value")]
            text = " ".join(text for text in texts if isinstance(text, str))
            if words.search(text) and id(node) not in documentation:
                found.append(f"{place(path, node)}: {text[:60]}")
    assert found == []


def test_options_are_keyword_only_and_described():
    import inspect

    found = []
    for row in shipped():
        if row.kind == "kind":
            continue
        signature = inspect.signature(row.load())
        described = arguments(row.load())
        for option in options(row):
            if signature.parameters[option.name].kind is not inspect.Parameter.KEYWORD_ONLY:
                found.append(f"{row}: {option.name} is not keyword-only")
            if not described.get(option.name):
                found.append(f"{row}: {option.name} is not described")
        found += [] if packages.first_line(row).endswith(".") else [f"{row}: no first line"]
    assert found == []


def presets() -> list[tuple[str, str]]:
    return [(kind, name) for kind in KINDS for name in packages.presets(kind) if name != "none"]


def test_no_preset_has_a_plugins_name():
    """Hydra would find the preset first, and it would extend itself."""
    assert [(kind, name) for kind, name in presets() if name in catalog().names(kind)] == []


@pytest.mark.parametrize(("kind", "name"), presets())
def test_presets_compose(kind, name, tmp_path):
    chosen = f"[{name}]" if base_of(kind).many else name
    losses = "{loss: []}, " if kind == "method" else ""  # which a preset of a method names
    (tmp_path / "config.yaml").write_text(
        f"defaults: [{losses}{{{kind}: {chosen}}}, _self_]\nhydra: {{searchpath: ['file://{paths.CONF}', 'anystyle://']}}\n"
    )
    node = compose("config", conf=tmp_path)[kind]
    node = node[name] if base_of(kind).many else node
    assert catalog().owner(kind, node._target_).kind == kind


@pytest.mark.parametrize("told", [r"(?<![\w.])/(home|root|work|Users|mnt|data)/\w+", r"github\.com/anystyle"])
def test_no_machine_is_written_down_and_no_address_is_invented(told):
    files = [*TEXTS, ROOT / "pyproject.toml", ROOT / "CITATION.cff", ROOT / "docs" / "site" / "mkdocs.yml"]
    assert [str(path.relative_to(ROOT)) for path in files if re.search(told, path.read_text(encoding="utf-8"))] == []


def test_imports_point_down():
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]


def test_no_imports_run_in_a_circle():
    graph = grimp.build_graph("anystyle", exclude_type_checking_imports=True, cache_dir=None)
    TopologicalSorter({name: graph.find_modules_directly_imported_by(name) for name in graph.modules}).prepare()


def test_importing_anystyle_costs_nothing():
    code = (
        "import sys, anystyle.contracts.command;"
        "print(sorted(n for n in sys.modules if n.split('.')[0] in ('torch', 'hydra', 'numpy')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("given", "spins"), [({}, "0"), ({"GOMP_SPINCOUNT": "77"}, "77"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "30000000000")]
)
def test_threads_that_wait_do_not_spin(given: dict[str, str], spins: str):
    environment = {key: value for key, value in os.environ.items() if key not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    done = subprocess.run(
        [sys.executable, "-c", "import anystyle, torch"],
        capture_output=True, text=True, check=True, env={**environment, **given, "OMP_DISPLAY_ENV": "VERBOSE"},
    )  # fmt: skip
    found = re.search(r"GOMP_SPINCOUNT = '(\d+)'", done.stderr)
    if found is None:
        pytest.skip("this PyTorch has another OpenMP than GNU's")
    assert found[1] == spins


def surface() -> dict[str, object]:
    """What people build on: every change of it is a change for them."""
    plugins: dict[str, dict[str, dict[str, str]]] = {kind: {} for kind in sorted(kinds())}
    for row in sorted((row for row in shipped() if row.kind != "kind"), key=lambda row: (row.kind, row.name)):
        plugins[row.kind][row.name] = {
            option.name: shown(option.hint) + ("" if option.required else f" = {option.default!r}")
            for option in options(row)
        }
    return {"anystyle": sorted(anystyle.__all__), "kinds": sorted(kinds()), "plugins": plugins}


def test_the_public_surface_is_written_down():
    assert surface() == json.loads(SURFACE.read_text()), "if the change is meant, run: python tests/test_house.py"


if __name__ == "__main__":
    SURFACE.write_text(json.dumps(surface(), indent=2) + "\n")
