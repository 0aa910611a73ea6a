"""Separating a command's own flags from Hydra's overrides and flags."""

import argparse
import re
from collections.abc import Mapping, Sequence
from typing import NoReturn

from anystyle.errors import UserError, did_you_mean

_OVERRIDE = re.compile(r"(\+\+?)?[A-Za-z_][\w./@:$-]*=|~[A-Za-z_][\w./@:-]*(=|$)")
HYDRA: dict[str, int] = {
    "-m": 0, "--multirun": 0,
    "-c": 1, "--cfg": 1, "--resolve": 0, "-p": 1, "--package": 1,
    "-cd": 1, "--config-dir": 1, "-cp": 1, "--config-path": 1, "-cn": 1, "--config-name": 1,
    "-sc": 0, "--shell-completion": 0, "--hydra-help": 0, "-i": 0, "--info": 0, "-r": 0, "--run": 0,
}  # fmt: skip
"""Hydra's own flags, and how many words follow each."""
MODES = ("--run", "--multirun", "--cfg", "--info", "--shell-completion", "-r", "-m", "-c", "-i", "-sc")
"""Hydra's flags that exclude each other."""
CONFIGURATIONS = ("job", "hydra", "all")
INFORMATION = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")

EPILOG = """\
Hydra: GROUP=NAME picks a component, KEY=VALUE sets an option; a file name with '=' in it needs ./ before.
  -m, --multirun         run every combination of the values given as KEY=A,B
  -c, --cfg job          show the configuration instead of running
  -cd, --config-dir DIR  add a folder of configurations
  --info [defaults|...]  show how the configuration is composed; --hydra-help lists the rest
"""


def new_parser(command: str, description: str | None = None, epilog: str | None = None) -> argparse.ArgumentParser:
    """The parser of ``anystyle COMMAND``; no flag may be abbreviated."""
    prog = f"anystyle {command}"
    return argparse.ArgumentParser(prog=prog, description=description, epilog=epilog, allow_abbrev=False)


def subcommand(command: str, about: str | None, choices: Mapping[str, str], words: Sequence[str]) -> str | None:
    """The subcommand that the first word names; ``None`` where help is asked for, which is printed."""
    if not words or words[0] in ("-h", "--help", "help"):
        rows = "\n".join(f"  {name:<8} {text}" for name, text in choices.items())
        more = f"anystyle {command} COMMAND --help says more."
        print(f"usage: anystyle {command} COMMAND ...\n\n{about}\n\n{rows}\n\n{more}")
        return None
    if words[0] not in choices:
        near = did_you_mean(words[0], choices)
        raise UserError(f"no {command} command is named {words[0]!r}.{near} Commands: {', '.join(choices)}")
    return words[0]


def is_override(word: str) -> bool:
    """Whether a word is an override in Hydra's grammar: ``key=value``, ``+key=value``, ``~key``."""
    return _OVERRIDE.match(word) is not None


def split(parser: argparse.ArgumentParser, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Read a command's flags, and return the words that are Hydra's: overrides and its own flags.

    A word after a flag that takes a value is that value, whatever it looks like: ``--text "a=b"`` is a text. Words
    after ``--`` are inputs.
    """
    actions = parser._option_string_actions
    ours: list[str] = []
    hydra: list[str] = []
    overrides: list[str] = []
    index = 0
    while index < len(words):
        word = words[index]
        flag, has_value = word.partition("=")[0], "=" in word
        index += 1
        if word == "--":
            ours.extend(words[index - 1 :])
            break
        if flag in actions:
            ours.append(word)
            if not has_value and actions[flag].nargs != 0 and index < len(words):
                # After a space argparse would take `-z` for a flag.
                joined = actions[flag].nargs is None and re.match(r"-.", words[index]) and words[index] not in actions
                ours[-1:] = [f"{word}={words[index]}"] if joined else [word, words[index]]
                index += 1
        elif flag in HYDRA:
            follow = 0 if has_value else HYDRA[flag]
            if flag in ("-i", "--info") and index < len(words) and re.fullmatch(r"[a-z-]+", words[index]):
                follow = 1
            hydra.extend(words[index - 1 : index + follow])
            index += follow
            if flag in ("-i", "--info") and follow and hydra[-1].removeprefix(f"{flag}=") not in INFORMATION:
                raise UserError(f"--info takes one of {', '.join(INFORMATION)}")
            if flag in ("-c", "--cfg") and hydra[-1].removeprefix(f"{flag}=") not in CONFIGURATIONS:
                raise UserError(f"--cfg takes one of {', '.join(CONFIGURATIONS)}")
        elif is_override(word):
            overrides.append(word)
        else:
            ours.append(word)
    # Hydra reads overrides in one row only.
    return parse(parser, ours), [*overrides, *hydra]


def parse(parser: argparse.ArgumentParser, words: Sequence[str]) -> argparse.Namespace:
    """Read words that hold none of Hydra's."""

    def fail(message: str) -> NoReturn:
        unknown = re.search(r"unrecognized arguments: (-\S+)", message)
        near = did_you_mean(unknown[1], [*parser._option_string_actions, *HYDRA]) if unknown else ""
        raise UserError(f"{message}.{near} See: {parser.prog} --help")

    parser.error = fail
    mixed = not any(action.nargs in (argparse.PARSER, argparse.REMAINDER) for action in parser._actions)
    return parser.parse_intermixed_args(list(words)) if mixed else parser.parse_args(words)
