"""Who declares which plugin, and what happens when somebody gets it wrong."""

import inspect
import os
from importlib.metadata import EntryPoint, EntryPoints
from types import SimpleNamespace

import pytest

import anystyle.registry.catalog as module
from anystyle.contracts import Placement
from anystyle.errors import Terminated
from anystyle.registry.build import build
from anystyle.registry.builtin import BUILTIN, KINDS, MANY
from anystyle.registry.catalog import PluginError, base_of, catalog, plugin
from tests.support.refusals import raises_line

GOOD = """
from anystyle.contracts import Placement
class Good(Placement):
    def select(self, sites):
        return tuple(sites)
"""


def test_a_class_has_the_name_that_it_is_registered_by():
    rows = [row for row in catalog() if row.kind == "backbone"]
    assert [catalog().name_of("backbone", row.load()) for row in rows] == [row.name for row in rows]
    assert catalog().name_of("backbone", Placement) == "anystyle.contracts.style.Placement"


def test_unknown_names_suggest():
    told = r"no placement is named 'heads'. Did you mean 'head'\? Available: .*full, head"
    with pytest.raises(PluginError, match=told):
        catalog().find("placement", "heads")
    with pytest.raises(PluginError, match=r"no kind of plugin is named 'losses'\. Did you mean 'loss'\?"):
        catalog().names("losses")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("raise RuntimeError('imported')", r"cannot be imported: RuntimeError: imported \(\w+\.py, line 1\)$"),
        ("import nowhere", r"imported: ModuleNotFoundError: No module named 'nowhere' \(\w+\.py, line 1\)$"),
        ("class Broken(:\n", "cannot be imported: SyntaxError: invalid syntax"),
        ("\nraise SystemExit(3)", r"cannot be imported: SystemExit: 3 \(\w+\.py, line 2\)$"),
        ("class Broken: pass", r"must inherit from anystyle\.contracts\.Placement"),
        ("Broken = 3", r"must inherit from anystyle\.contracts\.Placement"),
        (GOOD, "has no attribute 'Broken'"),
    ],
)
def test_a_broken_plugin_is_listed_without_import_and_told_in_one_line_when_loaded(plugin_folder, code, message):
    root = plugin_folder(code, broken="Broken")
    plugin_folder("", toml="[project\nnonsense")
    plugin_folder("", toml='project = "text"')
    row = catalog().find("placement", "broken")
    assert row.origin == str(root) and "broken" in catalog().names("placement")
    with raises_line(PluginError, match=message):
        row.load()
    assert issubclass(catalog().find("placement", "head").load(), Placement)


def test_a_signal_while_a_plugin_is_imported_is_no_error_of_it(plugin_folder):
    plugin_folder("from anystyle.errors import Terminated\nraise Terminated(143)", broken="Broken")
    with pytest.raises(Terminated):
        catalog().find("placement", "broken").load()


def test_a_plugin_that_lacks_a_method_is_told_as_it_is_built(plugin_folder):
    plugin_folder("from anystyle.contracts import Placement\nclass Half(Placement): ...", half="Half")
    with pytest.raises(PluginError, match=r"placement 'half' \(.*\) lacks select, which every placement has"):
        build(Placement, "half")


def test_module_of_another_place_is_refused(plugin_folder):
    plugin_folder("", toml='[project.entry-points."anystyle.placement"]\nx = "json:JSONDecoder"')
    with pytest.raises(PluginError, match="another module is called 'json'"):
        catalog().find("placement", "x").load()


def test_relative_and_repeated_folders_are_one_absolute_one(plugin_folder, tmp_path, monkeypatch):
    root = plugin_folder(GOOD, folder="here", good="Good")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ANYSTYLE_PLUGINS", os.pathsep.join(["here", str(tmp_path)]))
    assert catalog().find("placement", "good").root == root
    assert os.environ["ANYSTYLE_PLUGINS"] == os.pathsep.join([str(root), str(tmp_path)])


def test_folder_of_folders(plugin_folder, tmp_path, monkeypatch):
    plugin_folder(GOOD, one="Good")
    plugin_folder(GOOD, two="Good")
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path))
    assert {"one", "two"} <= set(catalog().names("placement"))
    assert catalog().find("placement", "two").load().__name__ == "Good"


def test_two_declarations_fail_on_use_only(plugin_folder):
    root = plugin_folder(GOOD, head="Good")
    assert catalog().names("placement").count("head") == 1
    with pytest.raises(PluginError, match=r"'head' is declared more than once: .*by anystyle\); .*" + root.name):
        catalog().find("placement", "head")
    assert catalog().find("placement", "full").name == "full"


@pytest.mark.parametrize(
    ("toml", "problem"),
    [
        ('[project.entry-points."anystyle.backbon"]\nx = "a:B"', "no such kind"),
        ('[project.entry-points."anystyle.loss"]\n"a b" = "a:B"', "letters, digits"),
        ('[project.entry-points."anystyle.loss"]\nx = "a.B"', "not 'module:Class'"),
        ('[project.entry-points."anystyle.loss"]\nx = 3', "not 'module:Class'"),
        ("[project", "cannot be read"),
        ("a = " + "[" * 10_000, "is nested deeper than"),
    ],
)
def test_problems_are_told(plugin_folder, toml, problem):
    plugin_folder("", toml=toml)
    assert any(problem in line for line in catalog().problems)
    with pytest.raises(PluginError, match=f"no loss is named 'nothing'.*ignored: .*{problem}"):
        catalog().find("loss", "nothing")


def test_folder_that_is_none(monkeypatch, tmp_path):
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path / "nowhere"))
    assert any("nowhere, which is not a folder" in line for line in catalog().problems)


def _installed(monkeypatch: pytest.MonkeyPatch, *points: tuple[str, str, str, str]) -> None:
    found = []
    for project, group, name, value in points:
        point = EntryPoint(name, value, group)
        vars(point)["dist"] = SimpleNamespace(name=project, version="1.2")
        found.append(point)
    monkeypatch.setattr(module, "entry_points", lambda: EntryPoints(found))
    monkeypatch.setattr(module, "_static", inspect.unwrap(module._static))


def test_installed_packages(monkeypatch):
    _installed(
        monkeypatch,
        ("acme-placements", "anystyle.placement", "acme", "anystyle.placements:Head [extra]"),
        ("other", "console_scripts", "acme", "x:y"),
    )
    row = catalog().find("placement", "acme")
    assert (row.origin, row.target) == ("acme-placements 1.2", "anystyle.placements:Head")
    assert row.load().__name__ == "Head"


def test_folder_that_is_installed_too_is_one_plugin(monkeypatch, plugin_folder):
    root = plugin_folder(GOOD, toml="")
    code = next(root.glob("*.py")).stem
    (root / "pyproject.toml").write_text(
        f'[project]\nname = "acme-good"\n[project.entry-points."anystyle.placement"]\ngood = "{code}:Good"'
    )
    _installed(monkeypatch, ("acme_good", "anystyle.placement", "good", f"{code}:Good"))
    assert catalog().find("placement", "good").root == root
    _installed(monkeypatch, ("somebody-else", "anystyle.placement", "good", f"{code}:Good"))
    with pytest.raises(PluginError, match=r"declared more than once: .*somebody-else 1\.2"):
        catalog().find("placement", "good")


def test_decorator_for_notebooks(monkeypatch):
    monkeypatch.setattr(module, "_OWN", {})

    class Mine(Placement):
        def select(self, sites):
            return tuple(sites)

    assert plugin("placement", "mine")(Mine) is Mine and catalog().find("placement", "mine").load() is Mine
    again = type("Mine", (Mine,), {"__qualname__": Mine.__qualname__, "__module__": Mine.__module__})
    plugin("placement", "mine")(again)
    assert catalog().find("placement", "mine").load() is again
    with pytest.raises(PluginError, match=r"is declared already: .*by anystyle"):
        plugin("placement", "head")(Mine)
    with pytest.raises(PluginError, match=r"is declared already: .*by this process"):
        plugin("placement", "mine")(type("Other", (Mine,), {}))
    with pytest.raises(PluginError, match="another name"):
        plugin("placement", "my own")(Mine)
    with pytest.raises(PluginError, match="must inherit from"):
        plugin("renderer", "mine")(Mine)
    with pytest.raises(PluginError, match="no kind of plugin is named 'plcement'"):
        plugin("plcement", "mine")(Mine)


def test_every_kind_has_rows_and_a_contract():
    assert set(BUILTIN) == set(KINDS)
    assert [kind for kind in KINDS if base_of(kind).many] == list(MANY)
