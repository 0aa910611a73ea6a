"""The contracts as plain functions: for tests, for notebooks and for ``anystyle plugins check``.

Example:
    >>> from anystyle.testing import assert_contract
    >>> def test_contract() -> None:
    ...     assert_contract("backbone", MyBackbone)
"""

from anystyle.testing.check import Check, ContractError, Outcome, Unavailable, report
from anystyle.testing.run import assert_contract, checks, run, run_named
from anystyle.testing.subject import Subject

__all__ = [
    "Check",
    "ContractError",
    "Outcome",
    "Subject",
    "Unavailable",
    "assert_contract",
    "checks",
    "report",
    "run",
    "run_named",
]
