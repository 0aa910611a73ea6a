"""Errors that users can cause: each is one line."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def raises_line(error: type[Exception], *, match: str | None = None, naming: object = "") -> Iterator[None]:
    """As ``pytest.raises``, with a message of one line, which names something wherever that stands in it."""
    with pytest.raises(error, match=match) as caught:
        yield
    assert "\n" not in str(caught.value) and str(naming) in str(caught.value)
