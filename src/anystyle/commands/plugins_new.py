"""Begin a plugin: a folder with a class that works, its declaration, a test and a README."""

import builtins
import importlib.util
import keyword
import os
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from anystyle import paths
from anystyle.cli.arguments import new_parser, parse
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import read_text
from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import VARIABLE, base_of, catalog, kinds
from anystyle.registry.packages import presets, source_file

_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")


def main(argv: Sequence[str]) -> int:
    """Run ``anystyle plugins new``."""
    parser = new_parser(
        "plugins new",
        "Write a folder with a small plugin that keeps its contract: a class, the line that declares it, a test "
        "and a README.",
    )
    parser.add_argument("kind", metavar="KIND", help="one of: " + ", ".join(kinds()))
    parser.add_argument("name", metavar="NAME", help="its name: a-z, 0-9 and '_'")
    parser.add_argument("--into", metavar="DIR", type=Path, default=Path("plugins"), help="where (default: plugins)")
    arguments = parse(parser, argv)
    folder = write(arguments.kind, arguments.name, arguments.into)
    module = f"anystyle_{arguments.name}"
    print(f"wrote {folder}: {module}.py, pyproject.toml, test_{module}.py, README.md")
    known = [paths.PLUGINS, *map(Path, filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)))]
    listed = arguments.into.resolve() in [each.resolve() for each in known]
    where = "" if listed else f"{VARIABLE}={arguments.into.absolute()} "
    print(f"next:  {where}anystyle plugins check {arguments.kind} {arguments.name}")
    return 0


def write(kind: str, name: str, into: Path) -> Path:
    """Write the folder of a new plugin, named after it, below ``into``, and return it."""
    base_of(kind)
    module = f"anystyle_{name}"
    _refuse(kind, name, module)
    folder = into / name
    if folder.exists():
        raise UserError(f"{folder} exists already; choose another NAME or --into DIR, nothing was written")
    source = _template(kind).read_text(encoding="utf-8")
    camel = "".join(word.capitalize() for word in name.split("_"))
    # A backbone named "embedder" would hide the Embedder that the module imports; "True" is a keyword.
    taken = keyword.iskeyword(camel) or camel in vars(builtins) or re.search(rf"\b{camel}\b", source)
    cls = f"My{camel}" if taken else camel
    words = _with_article(kind)
    facts = {"project": module.replace("_", "-"), "cls": cls, "kind": kind, "name": name, "module": module}
    major, minor, *_ = version("anystyle").split(".")
    facts["core"] = f">={major}.{minor},<{major}.{int(minor) + 1}"  # contracts do not change within a minor version
    facts |= {"words": words, "Words": words[0].upper() + words[1:], "use": _use(kind, name), "variable": VARIABLE}
    with atomic_directory(folder) as temporary:
        (temporary / f"{module}.py").write_text(_renamed(source, kind, name, cls), encoding="utf-8")
        for file in ("pyproject.toml", "test.py", "README.md"):
            text = read_text(Path(__file__).with_name("templates") / f"{file}.in").format(**facts)
            (temporary / file.replace("test.py", f"test_{module}.py")).write_text(text, encoding="utf-8")
    return folder


def _template(kind: str) -> Path:
    """The source of the smallest plugin of a kind: ``testing/toy/KIND.py`` of the package that declares the kind."""
    if kind in KINDS:
        return paths.PACKAGE / "testing" / "toy" / f"{kind}.py"
    row = catalog().find("kind", kind)
    module = f"{row.target.replace(':', '.').partition('.')[0]}.testing.toy.{kind}"
    file = source_file(module, row.root)
    if file is None:
        raise UserError(f"{row} has no module {module} that a new plugin could begin with; write the class by hand")
    return file


def _refuse(kind: str, name: str, module: str) -> None:
    """Raise for a name that cannot be used."""
    if not _NAME.fullmatch(name) or keyword.iskeyword(name):
        raise UserError(
            f"'{name}' cannot name a plugin; use a-z, 0-9 and '_', beginning with a letter, such as my_{kind}"
        )
    for row in catalog():
        if (row.kind, row.name) == (kind, name):
            raise UserError(f"{kind} '{name}' is declared already by {row.origin}; choose another name")
        if re.split("[.:]", row.target)[0] == module:
            raise UserError(f"the module {module} belongs to {row}; choose another name")
    if name in presets(kind):
        raise UserError(f"'{name}' is a preset of {kind} already; choose another name")
    if importlib.util.find_spec(module) is not None:
        raise UserError(f"a module {module} is installed already; choose another name")


def _renamed(source: str, kind: str, name: str, cls: str) -> str:
    """The source of the smallest plugin of a kind, with the names of the new one."""
    toy = "Toy" + "".join(word.capitalize() for word in kind.split("_"))
    body = f'"""{cls}, {_with_article(kind)} for anystyle."""\n' + source.partition("\n")[2]
    # In one pass: the name of the new class may begin with Toy, too.
    body = re.sub(r"\bToy[A-Z]\w*", lambda match: cls + ("" if match[0] == toy else match[0][3:]), body)
    return body.replace('new_parser("toy"', f'new_parser("{name}"').replace("# ruff: noqa: T201\n", "")


def _use(kind: str, name: str) -> str:
    if kind == "command":
        return f"Run it with `anystyle {name}`."
    if kind == "format":
        return f"Write it with `anystyle export SCENE --to {name} --out FILE`."
    choice, prefix = (f"[{name}]", f"{kind}.{name}") if base_of(kind).many else (name, kind)
    return f"Choose it with `{kind}={choice}`, and set an option with `{prefix}.OPTION=VALUE`."


def _with_article(kind: str) -> str:
    words = kind.replace("_", " ")
    return f"an {words}" if words[0] in "aeiou" else f"a {words}"
