"""``anystyle COMMAND ...``: find the command and run it; nothing else is imported."""

import ast
import io
import runpy
import sys

from anystyle.errors import UserError, did_you_mean
from anystyle.paths import PACKAGE

COMMANDS = ("stylize", "film", "train", "evaluate", "plugins", "weights")
_HELP = """\
usage: anystyle COMMAND ...

Single-pass stylization of 3D Gaussian scenes, guided by text and images.

{commands}

anystyle COMMAND --help says more; anystyle plugins lists what there is to choose from.
Shell completion: eval "$(anystyle -sc install=bash)"  (or zsh, fish)
"""


def available() -> dict[str, str]:
    """Every command with the first line that describes it, none of them imported."""
    described: dict[str, str] = {}
    for name in COMMANDS:
        text = ast.get_docstring(ast.parse((PACKAGE / "commands" / f"{name}.py").read_bytes())) or ""
        described[name] = text.partition("\n")[0]
    from anystyle.registry.catalog import catalog
    from anystyle.registry.packages import first_line

    for name in catalog().names("command"):
        described[name] = first_line(catalog().find("command", name))
    return described


def main() -> None:
    """Run one command: one of the core as the program ``python -m anystyle.commands.COMMAND``, or a plugin.

    A training that restarts itself for each device is then started by the same command.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as Python's error stream: names need not be UTF-8
    first, *rest = sys.argv[1:] or ["--help"]
    if first in ("-h", "--help", "help"):
        rows = "\n".join(f"  {name:<10} {text}" for name, text in available().items())
        sys.stdout.write(_HELP.format(commands=rows))
    elif first == "--version":
        from importlib.metadata import version

        sys.stdout.write(f"anystyle {version('anystyle')}\n")
    elif first in COMMANDS:
        sys.argv = [sys.argv[0], *rest]
        try:
            runpy.run_module(f"anystyle.commands.{first}", run_name="__main__", alter_sys=True)
        except KeyboardInterrupt:  # while the command's imports were under way
            sys.exit(130)
    else:
        from anystyle.cli.run import run

        run(lambda: _other(first, rest))


def _other(word: str, rest: list[str]) -> None:
    """Complete a shell's words, or run the command that a plugin package adds."""
    if word in ("-sc", "--shell-completion"):
        from anystyle.cli.launch import complete

        return complete(available(), rest)
    from anystyle.contracts.command import Command
    from anystyle.registry.build import build
    from anystyle.registry.catalog import catalog

    if word in catalog().names("command"):
        return build(Command, word)(rest)
    known = list(available())
    what = "flag" if word.startswith("-") else "command"
    raise UserError(f"no {what} is named '{word}'.{did_you_mean(word, known)} Commands: {', '.join(known)}")


if __name__ == "__main__":
    main()
