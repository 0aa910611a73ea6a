"""Fixtures of a browser."""

from tests.support.browsing import page, same_window  # noqa: F401
