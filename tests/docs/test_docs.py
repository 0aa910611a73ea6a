"""What the documentation shows is there: links, names, options and every command; run it with pytest tests/docs."""

import argparse
import ast
import importlib
import importlib.util
import re
import shlex
import sys
from functools import cache

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from anystyle.__main__ import available
from anystyle.cli.arguments import parse, split
from anystyle.commands.plugins_new import write
from anystyle.evaluation.run import Images
from anystyle.registry.catalog import kinds
from anystyle.registry.compose import compose
from tests.support.docs_cases import FENCE, INSTEAD, PAGES, ROOT, named, reason, shown

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))
COMPOSED = ("stylize", "film", "train", "evaluate")
EARLIER = "experiment=paper_head", "name=x", "out=x"
PROGRAM = re.compile(r"(srun |\w+=\S+ )*(anystyle|torchrun) ")
ELSEWHERE = {"add_a_plugin.md": "test_commands.py runs every command on it, on the plugins it shows"}
"""Notebooks are run from top to bottom by tests/notebooks, their commands with them."""
COMMANDS = sorted(
    {
        (named(page), INSTEAD.get(line, line))
        for page in PAGES
        if page.name not in ELSEWHERE
        for line in shown(page)
        if PROGRAM.match(line) and "fill in" not in str(reason(line))
    }
)


def _text(page):
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def _mine(tmp_path_factory):
    """The plugin that pages speak of, as `anystyle plugins new backbone mine` writes it."""
    with pytest.MonkeyPatch.context() as patch:
        folder = write("backbone", "mine", tmp_path_factory.mktemp("plugins"))
        patch.setenv("ANYSTYLE_PLUGINS", str(folder))
        patch.setattr("sys.path", list(sys.path))
        yield
    sys.modules.pop("anystyle_mine", None)


def _anchors(page):
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", _text(page)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", _text(page))):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{page.name} links to {target}, which does not exist"
        if anchor and there.suffix == ".md":
            assert anchor in _anchors(there), f"{page.name} links to {target}; there is {sorted(_anchors(there))}"


def test_every_page_can_be_reached():
    linked = set(re.findall(r"\]\((\w+\.md)", _text(ROOT / "docs" / "index.md")))
    assert linked == {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}


def test_findings_are_listed():
    linked = re.findall(r"\(\.\./(findings/[^)]+)\)", _text(ROOT / "docs" / "findings.md"))
    assert set(linked) == {f"findings/{script.name}" for script in (ROOT / "findings").glob("*.sh")}


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=named)
def test_names_exist(page):
    for name in set(re.findall(r"`(anystyle(?:\.\w+)+)(?:\(\))?`", _text(page))):
        module, parts = name, []
        while True:
            try:
                found = importlib.import_module(module)
                break
            except ModuleNotFoundError:
                module, _, last = module.rpartition(".")
                parts.insert(0, last)
        for part in parts:
            assert hasattr(found, part), f"{page.name} speaks of {name}, and {module} has no {part}"
            found = getattr(found, part)


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_files_and_variables_exist(page):
    for name in set(re.findall(r"`((?:src|conf|docs|tests|notebooks)/[\w./]*)`", FENCE.sub("", _text(page)))):
        assert (ROOT / name).exists() or (page.parent / name).exists(), f"{page.name} speaks of {name}"
    for name in set(re.findall(r"\bANYSTYLE_\w+", _text(page))) - {"ANYSTYLE_TEST_DATA"}:
        assert name in _sources(), f"{page.name} speaks of {name}, which nothing reads"


@cache
def _sources():
    files = [*(ROOT / "src").rglob("*.py"), *ROOT.glob("plugins/*/anystyle_*/**/*.py")]
    return "".join(path.read_text(encoding="utf-8") for path in files)


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_options_exist(page):
    for key in set(re.findall(r"`((?:training|trainer|views|branch|checkpoint|export)\.(?!py`)\w+)[`=]", _text(page))):
        assert any(_has(config, key) for config in _configurations()), f"{page.name} speaks of the option {key}"


@cache
def _configurations():
    roots = (("train", EARLIER), ("train", ("experiment=tiny_style", *EARLIER[1:])), ("stylize", ()))
    return [compose(root, list(words)) for root, words in roots]


def _has(config, key):
    try:
        return OmegaConf.select(config, key, throw_on_missing=False, default=_has) is not _has
    except OmegaConfBaseException:
        return False


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_code_is_python_and_its_imports_are_there(page):
    for language, body in FENCE.findall(_text(page)):
        if language != "python":
            continue
        for item in ast.walk(ast.parse(body if not body.startswith("    ") else "class _:\n" + body)):
            name = str(item.module) if isinstance(item, ast.ImportFrom) else ""
            if name.startswith("anystyle") and name != "anystyle_mine":  # the reader's plugin
                module = importlib.import_module(name)
                assert all(hasattr(module, alias.name) for alias in item.names)


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=[f"{page}: {line[:60]}" for page, line in COMMANDS])
def test_command_is_understood(page, line):
    words = [word for word in shlex.split(line, comments=True) if word != "..."]
    while "=" in words[0] or words[0] == "srun":
        words.pop(0)
    if words[0] == "torchrun":
        words = words[words.index("-m") + 1 :]
    command, *rest = words[1:]
    assert command in available(), f"{page} shows a command that does not exist: {line}"
    if rest == ["--help"]:
        return
    if command == "study":
        _study(*rest)
        return
    plugins = {"app": "app.command", "view": "viewer.command", "export": "formats.command_export"}
    if command in plugins:
        split(importlib.import_module(f"anystyle_{plugins[command]}").parser(), rest)
        return
    if command == "benchmark":
        if rest:
            split(importlib.import_module(f"anystyle_benchmark.command_{rest[0]}").parser(), rest[1:])
        return
    if command == "report":
        parse(importlib.import_module("anystyle_paper.command").parser(), rest)
        return
    module = importlib.import_module(f"anystyle.commands.{command}")
    if command in COMPOSED:
        _compose(command, module, rest)
    else:
        _plain(command, module, rest)


def _study(name=None, *words):
    commands = importlib.import_module("anystyle_study.commands")
    if name in commands.COMPOSED:
        _, rest = split(commands.COMPOSED[name][0](), words)
        commands.compose_command(name, [word for word in rest if "=" in word])
    elif name is not None:
        parse(commands.form_parser(), words)


def _compose(command, module, words):
    if command == "train":
        _, overrides = split(argparse.ArgumentParser(), words)
        overrides = [word for word in overrides if "=" in word or word.startswith("~")]
    else:
        arguments, overrides = split(module.parser(), words)
        overrides = [word for word in overrides if "=" in word or word.startswith("~")]
        if command == "evaluate":
            given = (getattr(arguments, name) for name in ("content", "style", "stylized", "depth", "layout"))
            overrides = [*(Images.WORDS if Images.of(*given) is not None else ()), *overrides]
    choices = [
        [
            f"{item.get_key_element()}={value}"
            for value in ([item.value().start] if item.is_interval_sweep() else item.sweep_string_iterator())
        ]
        if item.is_sweep_override()
        else [word]
        for word, item in zip(overrides, OverridesParser.create().parse_overrides(overrides), strict=True)
    ]
    named = ["name=x", "out=x"] if command == "train" else []
    # Every value of a sweep once: the first of all, the second of all, and the last of those that have fewer.
    for place in range(max(map(len, choices), default=1)):
        chosen = [values[min(place, len(values) - 1)] for values in choices]
        _composed(command, *(word for word in chosen if not word.startswith("name=")), *named)


@cache
def _composed(command, *words):
    """The words can be composed; many commands differ in their files alone."""
    compose(command, words)


def _plain(command, module, words):
    """Words of a command, or of a sub-command, which has a module of its own or shares that of the command."""
    below = f"anystyle.commands.{command}_{words[0]}" if words and words[0].isidentifier() else module.__name__
    if own := bool(importlib.util.find_spec(below) and below != module.__name__):
        module, words = importlib.import_module(below), words[1:]
    if hasattr(module, "parser"):
        given = parse(module.parser(), words[1:] if words[:1] == ["list"] else words)
        assert own or command != "plugins" or not words or words[0] in kinds(), given
    else:
        with pytest.MonkeyPatch.context() as patch, pytest.raises(_ParsedError):
            patch.setattr(module, "parse", _parse_only)
            module.main(words)


class _ParsedError(Exception):
    pass


def _parse_only(parser, words):
    parse(parser, words)
    raise _ParsedError
