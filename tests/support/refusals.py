"""Errors that users can cause: each is one line."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def raises_line(error: type[Exception], *, match: str) -> Iterator[None]:
    """As ``pytest.raises``, with a message of one line."""
    with pytest.raises(error, match=match) as caught:
        yield
    assert "\n" not in str(caught.value)
