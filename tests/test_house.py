"""The house rules, executable.

The public surface is written down in ``surface.json``: the catalog's names, the built-in plugins' options and what
``anystyle`` exports. A change that is meant is written down by ``python tests/test_house.py`` and told in the
changelog.
"""

import ast
import importlib
import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import lightning.pytorch as lightning
import pytest

import anystyle
from anystyle import paths
from anystyle.commands.plugins import arguments
from anystyle.registry import packages
from anystyle.registry.builtin import BUILTIN, KINDS
from anystyle.registry.catalog import Plugin, catalog
from anystyle.registry.compose import compose
from anystyle.registry.schema import options
from anystyle.registry.source_docs import peek

ROOT = Path(__file__).parent.parent
SURFACE = Path(__file__).parent / "surface.json"
SOURCES = sorted(paths.PACKAGE.rglob("*.py"))
SHIPPED = [*SOURCES, *sorted(paths.PLUGINS.rglob("*.py"))]
TEXTS = [
    path
    for folder in (paths.PACKAGE, paths.PLUGINS, paths.CONF, ROOT / "docs", ROOT / "notebooks")
    for path in sorted(folder.rglob("*"))
    if path.suffix in (".py", ".toml", ".yaml", ".md", ".ipynb", ".json", ".cff")
] + sorted(ROOT.glob("*.md"))

MAX_LINES, RARELY_LINES = 400, 300
MAX_BODY, RARELY_BODY = 60, 40


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


def test_the_rules_see_the_code():
    assert len(SOURCES) > 50 and len(TEXTS) > len(SOURCES)
    assert any(True for _ in calls("build"))


def test_print_belongs_to_commands():
    allowed = paths.PACKAGE / "commands"
    assert [place(path, node) for path, node in calls("print") if not path.is_relative_to(allowed)] == []


def test_no_device_is_written_down():
    found = [place(path, node) for path, node in calls("cuda")]
    for path, node in calls("to"):
        values = [argument.value for argument in node.args if isinstance(argument, ast.Constant)]
        found += [place(path, node) for value in values if isinstance(value, str) and value.startswith("cuda")]
    assert found == []


def test_loading_is_strict():
    found = []
    for path, node in nodes(ast.Call):
        assert isinstance(node, ast.Call)
        name = getattr(node.func, "id", None)  # zip has another "strict"
        for keyword in node.keywords:
            if keyword.arg == "strict" and name != "zip" and getattr(keyword.value, "value", None) is False:
                found.append(place(path, node))
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
    found = [place(path, node) for path, node in nodes(ast.ImportFrom) if node.module == "__future__"]
    assert found == []


def test_no_duck_is_probed():
    assert [place(path, node) for path, node in calls("hasattr")] == []


def test_every_public_method_says_what_it_does():
    """Its docstring, or that of what it overrides: here, or in ``torch`` and Lightning."""
    framework = {*dir(lightning.Callback), *dir(lightning.LightningModule), *dir(lightning.LightningDataModule)}
    classes: dict[str, list[ast.ClassDef]] = defaultdict(list)
    for _, node in nodes(ast.ClassDef):
        assert isinstance(node, ast.ClassDef)
        classes[node.name].append(node)

    def documented(node: ast.ClassDef) -> set[str]:
        names = {one.name for one in node.body if isinstance(one, ast.FunctionDef) and ast.get_docstring(one)}
        bases = {getattr(base, "id", getattr(base, "attr", "")) for base in node.bases} - {node.name}
        return names.union(framework, *(documented(base) for name in bases for base in classes[name]))

    silent = [
        f"{place(path, one)} {node.name}.{one.name}"
        for path, node in nodes(ast.ClassDef)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        for one in node.body
        if isinstance(one, ast.FunctionDef) and not one.name.startswith("_") and one.name not in documented(node)
    ]
    assert silent == []


def test_packages_are_packages():
    folders = {path.parent for path in SOURCES}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_files_and_functions_are_short():
    files = {path: path.read_text().count("\n") for path in SHIPPED}
    bodies: dict[str, int] = {}
    for path, node in nodes(ast.FunctionDef, ast.AsyncFunctionDef):
        assert isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        first = node.body[1] if ast.get_docstring(node) and len(node.body) > 1 else node.body[0]
        bodies[place(path, node)] = (node.end_lineno or 0) - first.lineno + 1
    for sizes, most, rarely, share in ((files, MAX_LINES, RARELY_LINES, 0.1), (bodies, MAX_BODY, RARELY_BODY, 0.03)):
        long = {str(what): size for what, size in sizes.items() if size > rarely}
        assert [what for what, size in long.items() if size > most] == []
        assert len(long) <= share * len(sizes), long


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


def test_one_plugin_a_file():
    targets = [target.partition(":")[0] for rows in BUILTIN.values() for target in rows.values()]
    assert sorted(targets) == sorted(set(targets))


def test_no_code_knows_a_plugin_package():
    """No text and no import in the package speaks of what lies in ``plugins/``, and no name of a backbone."""
    folders = {folder.name for folder in paths.PLUGINS.iterdir() if (folder / "pyproject.toml").is_file()}
    backbones = set(catalog().names("backbone"))
    assert folders & backbones and folders - backbones
    found = []
    for path in SOURCES:
        documentation = {id(node.value) for node in nodes_of(path) if isinstance(node, ast.Expr)}
        for node in nodes_of(path):
            for fields, words in (
                (("id", "attr", "arg", "name"), backbones),
                (("module", "value"), folders | backbones),
            ):
                texts = [getattr(node, field, None) for field in fields]
                text = " ".join(text for text in texts if isinstance(text, str))
                spoken = re.search(rf"(?<![a-z])({'|'.join(sorted(words))})(?![a-z])", text, re.IGNORECASE)
                if spoken and id(node) not in documentation:
                    found.append(f"{place(path, node)}: {text[:60]}")
    assert found == []


VAGUE = {"found", "made", "own", "place", "places", "share", "some", "told", "wanted"}
"""Names that do not say what they are; see CONTRIBUTING.md."""


def vague_names(path: Path) -> list[str]:
    """Variables, parameters, functions and attributes of a file with such a name."""
    named = []
    for node in nodes_of(path):
        if isinstance(node, ast.arg):
            named.append((node.arg, node))
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            named.append((node.id, node))
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            named.append((node.attr, node))
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            named.append((node.name, node))
    return [f"{place(path, node)}: {name}" for name, node in named if name in VAGUE]


def test_names_say_what_they_are():
    assert [name for path in SHIPPED for name in vague_names(path)] == []


def test_options_are_keyword_only_and_described():
    import inspect

    found = []
    for row in shipped():
        signature = inspect.signature(row.load())
        described = arguments(row.load())
        for option in options(row):
            if signature.parameters[option.name].kind is not inspect.Parameter.KEYWORD_ONLY:
                found.append(f"{row}: {option.name} is not keyword-only")
            if not described.get(option.name):
                found.append(f"{row}: {option.name} is not described")
        found += [] if peek(row).description.endswith(".") else [f"{row}: no first line"]
    assert found == []


def presets() -> list[tuple[str, str]]:
    return [(kind, name) for kind in KINDS for name in packages.presets(kind)]


def test_no_preset_has_a_plugins_name():
    """Hydra would find the preset first, and it would extend itself."""
    assert [(kind, name) for kind, name in presets() if name in catalog().names(kind)] == []


@pytest.mark.parametrize(("kind", "name"), presets())
def test_presets_compose(kind, name, tmp_path):
    chosen = f"[{name}]" if KINDS[kind].many else name
    losses = "{loss: []}, " if kind == "method" else ""  # which a preset of a method names
    (tmp_path / "config.yaml").write_text(
        f"defaults: [{losses}{{{kind}: {chosen}}}, _self_]\nhydra: {{searchpath: ['file://{paths.CONF}', 'anystyle://']}}\n"
    )
    node = compose("config", conf=tmp_path)[kind]
    node = node[name] if KINDS[kind].many else node
    assert catalog().owner(kind, node._target_).kind == kind


def test_no_machine_is_written_down():
    told = re.compile(r"(?<![\w.])/(home|root|work|Users|mnt|data)/\w+")
    found = [str(path.relative_to(ROOT)) for path in TEXTS if told.search(path.read_text(encoding="utf-8"))]
    assert found == []


def test_no_address_is_invented():
    files = [*TEXTS, ROOT / "pyproject.toml", ROOT / "CITATION.cff", ROOT / "docs" / "site" / "mkdocs.yml"]
    found = [str(path.relative_to(ROOT)) for path in files if "github.com/anystyle" in path.read_text(encoding="utf-8")]
    assert found == []


def test_imports_point_down():
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]


def test_no_imports_run_in_a_circle():
    graph = grimp.build_graph("anystyle", exclude_type_checking_imports=True, cache_dir=None)
    TopologicalSorter({name: graph.find_modules_directly_imported_by(name) for name in graph.modules}).prepare()


def test_importing_anystyle_costs_nothing():
    code = (
        "import sys, anystyle; print(sorted(n for n in sys.modules if n.split('.')[0] in ('torch', 'hydra', 'numpy')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_exports_are_there():
    for name in anystyle.__all__:
        assert getattr(anystyle, name) is not None
        assert name in dir(anystyle)
    assert anystyle.Stylizer is importlib.import_module("anystyle.stylizer").Stylizer
    assert re.match(r"\d+\.\d+", anystyle.__version__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        anystyle.nothing  # noqa: B018


def surface() -> dict[str, object]:
    """What people build on: every change of it is a change for them."""
    plugins: dict[str, dict[str, dict[str, str]]] = {kind: {} for kind in sorted(KINDS)}
    for row in sorted(shipped(), key=lambda row: (row.kind, row.name)):
        written = {}
        for text in peek(row).options:
            name, _, rest = text.partition(":")
            written[name] = rest.strip()
        plugins[row.kind][row.name] = written
    return {"anystyle": sorted(anystyle.__all__), "kinds": sorted(KINDS), "plugins": plugins}


def test_the_public_surface_is_written_down():
    assert surface() == json.loads(SURFACE.read_text()), "if the change is meant, run: python tests/test_house.py"


if __name__ == "__main__":
    SURFACE.write_text(json.dumps(surface(), indent=2) + "\n")
