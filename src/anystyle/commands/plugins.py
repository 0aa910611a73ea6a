"""List the plugins, show one with its options, check one, or write a new one."""

import importlib
import inspect
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence

from anystyle import paths
from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import run, words_of
from anystyle.registry.builtin import MANY
from anystyle.registry.catalog import Catalog, Plugin, base_of, catalog, kinds
from anystyle.registry.packages import first_line, presets


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle plugins``."""
    given = words_of(words)
    if given and given[0] in ("check", "new"):
        if status := importlib.import_module(f"anystyle.commands.plugins_{given[0]}").main(given[1:]):
            sys.exit(status)
        return
    parser = new_parser(
        "plugins",
        "Without arguments, or with list: every plugin by name. With a KIND: what each is. With a NAME: one plugin "
        "in full, with its options; only this imports it.",
        epilog="anystyle plugins check KIND NAME checks a plugin; anystyle plugins new KIND NAME writes a new one.",
    )
    parser.add_argument("kind", nargs="?", help="one of: " + ", ".join(kinds()))
    parser.add_argument("name", nargs="?", help="a plugin of that kind")
    arguments, known = parse(parser, [] if given == ["list"] else given), catalog()
    if arguments.kind is None:
        lines = overview(known)
    elif arguments.name is None:
        lines = of_kind(known, arguments.kind)
    else:
        lines = in_full(known.find(arguments.kind, arguments.name))
    print("\n".join(lines))


def overview(known: Catalog) -> Iterator[str]:
    """Every kind with the names of its plugins."""
    column = max(map(len, kinds())) + 3
    for kind in kinds():
        title = f"{kind}*" if kind in MANY else kind
        yield from _hanging(f"{title:<{column}}", ", ".join(known.names(kind)) or "-")
    yield ""
    yield "* several at once, as in loss=[content,style]. More: anystyle plugins KIND [NAME]"


def of_kind(known: Catalog, kind: str) -> Iterator[str]:
    """Every plugin of a kind: name, description, origin."""
    names = known.names(kind)
    column = max(map(len, names), default=0) + 2
    if not names:
        yield f"no {kind} is declared"
    for name in names:
        for plugin in known.declarations(kind, name):
            origin = "" if plugin.origin == "anystyle" else f"  [{plugin.origin}]"
            yield from _hanging(f"{name:<{column}}", first_line(plugin) + origin)
        if len(known.declarations(kind, name)) > 1:
            yield " " * column + "(declared more than once: it cannot be used until one is renamed)"
    yield from _presets(kind, names)
    if names:
        yield ""
        yield f"Options: anystyle plugins {kind} {names[0]}"


def _presets(kind: str, names: Sequence[str]) -> Iterator[str]:
    """The presets of a kind, with the comment that each begins with."""
    files = [file for name, file in presets(kind).items() if name not in names]
    column = max((len(file.stem) for file in files), default=0) + 2
    if files:
        yield ""
        yield "Presets:"
    for file in files:
        comments = [line for line in file.read_text(encoding="utf-8").splitlines() if re.match(r"# *[^@ ]", line)]
        yield from _hanging(f"{file.stem:<{column}}", comments[0].lstrip("# ") if comments else paths.shown(file))


def in_full(plugin: Plugin) -> Iterator[str]:
    """One plugin, imported: its documentation, and every option with type and default."""
    from anystyle.registry.schema import options, shown

    known = options(plugin)
    loaded = plugin.load()
    yield f"{plugin.kind}={plugin.name}  ({plugin.target}, declared by {plugin.origin})"
    yield ""
    yield re.split(r"\n\n(?:Args|Raises):", inspect.getdoc(loaded) or "")[0]
    yield ""
    if not known:
        yield "It takes no options."
        return
    yield "Options:"
    described = arguments(loaded)
    prefix = f"{plugin.kind}.{plugin.name}" if base_of(plugin.kind).many else plugin.kind
    for option in known:
        default = "  (must be given)" if option.required else f" = {option.default!r}"
        yield f"  {prefix}.{option.name}: {shown(option.hint)}{default}"
        if option.name in described:
            yield from _hanging(" " * 6, described[option.name])


def arguments(function: object) -> dict[str, str]:
    """The ``Args`` of a docstring by argument; a base class's where a class does not describe one."""
    described: dict[str, str] = {}
    for owner in reversed(getattr(function, "__mro__", (function,))):
        section = re.search(r"^Args:\n((?:[ \t]+.*\n?|\n)*)", inspect.cleandoc(owner.__doc__ or ""), re.MULTILINE)
        for entry in re.split(r"\n(?=\w)", textwrap.dedent(section[1]) if section else ""):
            name, _, text = entry.partition(":")
            described[name.partition(" ")[0]] = " ".join(text.split())
    return described


def _hanging(lead: str, text: str) -> list[str]:
    indent = " " * len(lead)
    width = max(60, shutil.get_terminal_size((100, 24)).columns) if sys.stdout.isatty() else 100
    return textwrap.wrap(
        text, width, initial_indent=lead, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    ) or [lead.rstrip()]


if __name__ == "__main__":
    run(main)
