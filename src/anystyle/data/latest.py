"""Keeping what was computed last."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Latest(Generic[K, V]):
    """The latest results of a function; threads may share it, and a pickled copy starts empty.

    Args:
        function: Of one argument; the same argument gives the same result.
        count: How many results are kept.
    """

    def __init__(self, function: Callable[[K], V], count: int) -> None:
        self._function = function
        self._count = count
        self._results: OrderedDict[K, V] = OrderedDict()
        self._lock = Lock()

    def __call__(self, key: K) -> V:
        """The result for ``key``, kept or new."""
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key]
        result = self._function(key)
        with self._lock:
            self._results[key] = result
            while len(self._results) > self._count:
                self._results.popitem(last=False)
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._function, self._count)
