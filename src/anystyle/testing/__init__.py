"""The contracts of plugins as plain pytest functions.

Every kind of plugin has a module here, such as :mod:`anystyle.testing.backbone`. Each of its functions whose name
begins with ``test_`` is one promise of the contract, on a :class:`Subject`. They run in three ways: with ``anystyle
plugins check KIND NAME``, by :func:`assert_contract` in a test of your own, and in anystyle's suite, over the catalog.

A package that declares a kind of its own brings a module ``testing/KIND.py`` with such functions, and the smallest
plugin of the kind in ``testing/toy/KIND.py``, which ``anystyle plugins new`` begins with.

Example:
    >>> from anystyle.testing import assert_contract
    >>> def test_contract() -> None:
    ...     assert_contract("backbone", MyBackbone)
"""

from anystyle.errors import MissingExtra

try:
    import pytest as _pytest  # noqa: F401
except ImportError as error:
    raise MissingExtra('the contracts of plugins are pytest functions: pip install "anystyle[testing]"') from error

from anystyle.testing.run import assert_contract, check
from anystyle.testing.subject import Subject, subject

__all__ = ["Subject", "assert_contract", "check", "subject"]
