"""What a command promises: see :class:`anystyle.contracts.Command`."""

import pytest

from anystyle.contracts import Command
from anystyle.errors import UserError
from anystyle.testing.asserts import ONE_LINE
from anystyle.testing.subject import Subject


def test_help_is_printed(plugin: Subject[Command]) -> None:
    """``--help`` prints how it is used, and ends with status 0."""
    try:
        plugin.instance(["--help"])
    except SystemExit as ended:
        assert not ended.code, f"exit status {ended.code} after --help"


def test_unknown_words_are_refused(plugin: Subject[Command]) -> None:
    """A flag that does not exist ends in a UserError of one line, not in a traceback or a run."""
    with pytest.raises(UserError, match=ONE_LINE):
        plugin.instance(["--no-such-flag"])
