"""Begin a plugin: a folder with a class that works, its declaration, a test and a README."""

import argparse
import ast
import builtins
import importlib.util
import keyword
import os
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

from anystyle import paths
from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import VARIABLE, catalog, kind_named
from anystyle.registry.packages import presets

TOYS = paths.PACKAGE / "testing" / "toy"
TEMPLATES = paths.PACKAGE / "commands" / "templates"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle plugins new``."""
    words = new_parser(
        "plugins new",
        "Write a folder with a plugin that works and keeps its contract: a class on trivial maths, the "
        "line that declares it, a test and a README.",
    )
    words.add_argument("kind", metavar="KIND", help="one of: " + ", ".join(KINDS))
    words.add_argument("name", metavar="NAME", help="how configurations call it: a-z, 0-9 and '_'")
    words.add_argument("--into", metavar="DIR", type=Path, default=Path("plugins"), help="where (default: plugins)")
    return words


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``anystyle plugins new``."""
    arguments = parse(parser(), words_of(argv))
    folder = write(arguments.kind, arguments.name, arguments.into)
    module = f"anystyle_{arguments.name}"
    print(f"wrote {folder}: {module}.py, pyproject.toml, test_{module}.py, README.md")
    listed = arguments.into.resolve() == paths.PLUGINS.resolve() or str(arguments.into.absolute()) in _listed()
    where = "" if listed else f"{VARIABLE}={arguments.into.absolute()} "
    print(f"next:  {where}anystyle plugins check {arguments.kind} {arguments.name}")
    return 0


def write(kind: str, name: str, into: Path) -> Path:
    """Write the folder of a new plugin, named after it, below ``into``, and return it.

    Raises:
        UserError: The kind is unknown, the name is taken or cannot be used, or the folder exists.
    """
    kind_named(kind)
    module = f"anystyle_{name}"
    _refuse(kind, name, module)
    folder = into / name
    if folder.exists():
        raise UserError(f"{folder} exists already; choose another NAME or --into DIR, nothing was written")
    source = (TOYS / f"{kind}.py").read_text(encoding="utf-8")
    cls = _class_name(name, source)
    words = kind.replace("_", " ")
    article = "an" if words[0] in "aeiou" else "a"
    many = KINDS[kind].many
    facts = {
        "project": module.replace("_", "-"),
        "cls": cls,
        "kind": kind,
        "words": words,
        "article": article,
        "Article": article.capitalize(),
        "name": name,
        "module": module,
        "choice": f"{kind}=[{name}]" if many else f"{kind}={name}",
        "prefix": f"{kind}.{name}" if many else kind,
        "variable": VARIABLE,
    }
    with atomic_directory(folder) as temporary:
        (temporary / f"{module}.py").write_text(_renamed(source, kind, cls), encoding="utf-8")
        for name in ("pyproject.toml", "test.py", "README.md"):
            text = (TEMPLATES / f"{name}.in").read_text(encoding="utf-8").format(**facts)
            (temporary / name.replace("test.py", f"test_{module}.py")).write_text(text, encoding="utf-8")
    return folder


def _refuse(kind: str, name: str, module: str) -> None:
    """Raise for a name that cannot be used."""
    if not _NAME.fullmatch(name) or keyword.iskeyword(name):
        raise UserError(
            f"'{name}' cannot name a plugin; use a-z, 0-9 and '_', beginning with a letter, such as my_{kind}"
        )
    known = catalog()
    if name in known.names(kind):
        owners = ", ".join(row.origin for row in known.declarations(kind, name))
        raise UserError(f"{kind} '{name}' is declared already by {owners}; choose another name")
    if name in presets(kind):
        raise UserError(f"'{name}' is a preset of {kind} already; choose another name")
    taken = [row for row in known if row.target.partition(":")[0].partition(".")[0] == module]
    if taken:
        raise UserError(f"the module {module} belongs to {taken[0]}; choose another name")
    if importlib.util.find_spec(module) is not None:
        raise UserError(f"a module {module} is installed already; choose another name")


def _class_name(name: str, source: str) -> str:
    camel = "".join(word.capitalize() for word in name.split("_"))
    # A class called as what the module imports, such as a backbone named "embedder", would hide that; "true" is a word
    # of the language's own.
    taken = keyword.iskeyword(camel) or camel in vars(builtins) or re.search(rf"\b{camel}\b", source)
    return f"My{camel}" if taken else camel


def _renamed(source: str, kind: str, cls: str) -> str:
    """The toy's source as that of a plugin: other names, and the contract's own words on each method."""
    toy = "Toy" + "".join(word.capitalize() for word in kind.split("_"))
    words = kind.replace("_", " ")
    body = f'"""{cls}, {"an" if words[0] in "aeiou" else "a"} {words} for anystyle."""\n' + source.partition("\n")[2]
    # In one pass: the plugin's own name may begin as the toys' do.
    body = re.sub(r"\bToy[A-Z]\w*", lambda match: cls + ("" if match[0] == toy else match[0][3:]), body)
    return re.sub(r'( *)"""See :meth:`(anystyle[\w.]+)`([^"]*)\."""', _documented, body)


def _documented(match: re.Match[str]) -> str:
    indent, name, more = match[1], match[2], match[3]
    *module, cls, method = name.split(".")
    file = paths.PACKAGE.parent.joinpath(*module).with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    owner = next(item for item in tree.body if isinstance(item, ast.ClassDef) and item.name == cls)
    function = next(item for item in owner.body if isinstance(item, ast.FunctionDef) and item.name == method)
    text = (ast.get_docstring(function) or "").strip()
    if more:
        text += "\n\n" + more.lstrip("; ").capitalize() + "."
    lines = textwrap.indent(text, indent)[len(indent) :]
    return f'{indent}"""{lines}"""' if "\n" not in text else f'{indent}"""{lines}\n{indent}"""'


def _listed() -> list[str]:
    return [str(Path(folder).absolute()) for folder in os.environ.get(VARIABLE, "").split(os.pathsep) if folder]


if __name__ == "__main__":
    run(main)
