"""Shell completion: commands here, everything after a command by Hydra."""

import os
from collections.abc import Iterable, Sequence

from anystyle import paths

_LINE = "COMP_LINE"


def complete(commands: Iterable[str], words: Sequence[str]) -> None:
    """Answer a shell: print its installation script, or the words that may come next.

    Args:
        commands: All commands.
        words: As Hydra takes them: ``install=bash``, ``uninstall=bash`` or ``query=bash``, with the line that is being
            typed in ``COMP_LINE``; likewise for zsh and fish.
    """
    from anystyle.commands._compose import launch

    names = list(commands)
    if any(word.startswith("query=") for word in words):
        typed = os.environ.get(_LINE, "").split(" ")[1:]
        command = typed[0] if typed else ""
        if len(typed) < 2:
            print(" ".join(name for name in names if name.startswith(command)))
            return
        if command not in names or not (paths.CONF / f"{command}.yaml").is_file():
            return
        os.environ[_LINE] = " ".join(typed)
        launch(command, _nothing, ["-sc", *words])
    else:
        configured = [name for name in names if (paths.CONF / f"{name}.yaml").is_file()]
        launch(configured[0], _nothing, ["-sc", *words])


def _nothing(config: object) -> None:
    """Stands for the command, which completing does not run."""
