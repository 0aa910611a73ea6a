"""A cache of bounded size that evicts what was not used for longest."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress
from threading import Lock
from typing import Any, Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class LRUCache(Generic[K, V]):
    """The most recently used values by key. Threads may share it; a pickled copy starts empty.

    Args:
        limit: The largest total size that is kept; 0 keeps nothing.
        size: Gives the size of a value, such as its bytes; by default each counts 1.
    """

    def __init__(self, limit: int, size: Callable[[V], int] | None = None) -> None:
        self.limit, self._size = limit, size
        self._values: OrderedDict[K, V] = OrderedDict()
        self._lock = Lock()
        self._total = 0

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: K) -> bool:
        return key in self._values

    def __getitem__(self, key: K) -> V:
        with self._lock:
            self._values.move_to_end(key)
            return self._values[key]

    def __setitem__(self, key: K, value: V) -> None:
        measure = self._size or (lambda _: 1)
        with self._lock:
            if key in self._values:
                self._total -= measure(self._values.pop(key))
            self._values[key] = value
            self._total += measure(value)
            while self._total > self.limit:
                self._total -= measure(self._values.popitem(last=False)[1])

    def get(self, key: K, compute: Callable[[], V]) -> V:
        """The value of ``key``, cached or computed; several threads may compute it at once."""
        with suppress(KeyError):
            return self[key]
        self[key] = value = compute()
        return value

    def clear(self) -> None:
        """Remove everything."""
        with self._lock:
            self._values.clear()
            self._total = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.limit, self._size)
