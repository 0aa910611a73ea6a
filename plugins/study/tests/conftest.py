"""Fixtures of a browser."""

from browsing import page, same_window  # noqa: F401
