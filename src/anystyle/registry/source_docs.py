"""A plugin's description and options, read from its source without importing it."""

import ast
import contextlib
import importlib.util
import inspect
from pathlib import Path
from typing import NamedTuple

from anystyle.registry.catalog import Plugin, kind_named
from anystyle.registry.packages import source_file

_HOPS = 3
"""The most modules that may re-export a class."""


class Summary(NamedTuple):
    """The first line of a class's docstring, and its options as the source writes them: ``pairs: int = 2``."""

    description: str
    options: tuple[str, ...] = ()


def peek(plugin: Plugin) -> Summary:
    """Read a plugin's description and options from its source; problems are described in place of the description."""
    if plugin.defined is not None:
        return Summary((inspect.getdoc(plugin.defined) or "").partition("\n")[0])
    module, _, name = plugin.target.partition(":")
    try:
        located = _class(module, name, plugin.root, _HOPS)
    except (OSError, SyntaxError, ValueError, ImportError) as error:
        return Summary(f"(cannot be read: {str(error).partition(chr(10))[0]})")
    if located is None:
        return Summary(f"(no class {name} in {module})")
    text = ast.get_docstring(located[1]) or ""
    return Summary(text.partition("\n")[0], tuple(_options(*located, plugin.root, kind_named(plugin.kind).runtime)))


def _class(module: str, name: str, root: Path | None, hops: int) -> tuple[str, ast.ClassDef] | None:
    """The module that defines a class, and its definition there."""
    file = source_file(module, root) or source_file(module, None)
    if file is None:
        raise ImportError(f"no source file of module {module}")
    tree = ast.parse(file.read_bytes())
    for statement in tree.body:
        if isinstance(statement, ast.ClassDef) and statement.name == name:
            return module, statement
        if isinstance(statement, ast.ImportFrom) and hops:
            for alias in statement.names:
                if (alias.asname or alias.name) == name:
                    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
                    relative = "." * statement.level + (statement.module or "")
                    origin = importlib.util.resolve_name(relative, package) if statement.level else relative
                    return _class(origin, alias.name, root, hops - 1)
    return None


def _options(module: str, definition: ast.ClassDef, root: Path | None, runtime: tuple[str, ...]) -> list[str]:
    """The options of a class's constructor or dataclass fields, and those that it inherits."""
    for statement in definition.body:
        if isinstance(statement, ast.FunctionDef) and statement.name == "__init__":
            signature = statement.args
            _, *plain = signature.posonlyargs + signature.args
            defaults = dict(zip(signature.kwonlyargs, signature.kw_defaults, strict=True))
            defaults.update(zip(reversed(plain), reversed(signature.defaults), strict=False))
            given = (argument for argument in [*plain, *signature.kwonlyargs] if argument.arg not in runtime)
            return [_written(item.arg, item.annotation, defaults.get(item)) for item in given]
    inherited: list[str] = []
    for base in definition.bases:
        with contextlib.suppress(OSError, SyntaxError, ValueError, ImportError):
            located = _class(module, base.id, root, _HOPS) if isinstance(base, ast.Name) else None
            inherited = inherited or (_options(*located, root, runtime) if located is not None else [])
    if not any("dataclass" in ast.unparse(decorator) for decorator in definition.decorator_list):
        return inherited
    fields = (statement for statement in definition.body if isinstance(statement, ast.AnnAssign))
    options = [field for field in fields if not ast.unparse(field.annotation).startswith("ClassVar")]
    return inherited + [_written(ast.unparse(field.target), field.annotation, field.value) for field in options]


def _written(name: str, annotation: ast.expr | None, default: ast.expr | None) -> str:
    hint = f": {ast.unparse(annotation)}" if annotation is not None else ""
    return f"{name}{hint}" + (f" = {ast.unparse(default)}" if default is not None else "")
