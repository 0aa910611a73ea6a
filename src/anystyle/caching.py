"""The one cache that forgets what was not used for longest."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class LRUCache(Generic[K, V]):
    """The most recently used values by key; threads may share it, and a pickled copy starts empty.

    Args:
        limit: The largest total size that is kept; 0 keeps nothing.
        size: Of a value, such as its bytes, as a function of a module; each counts 1 unless it is given.
    """

    def __init__(self, limit: int, size: Callable[[V], int] | None = None) -> None:
        self.limit = limit
        self._size = size
        self._values: OrderedDict[K, V] = OrderedDict()
        self._total = 0
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: K) -> bool:
        return key in self._values

    def __getitem__(self, key: K) -> V:
        with self._lock:
            self._values.move_to_end(key)
            return self._values[key]

    def __setitem__(self, key: K, value: V) -> None:
        with self._lock:
            if key in self._values:
                self._total -= self._measure(self._values.pop(key))
            self._values[key] = value
            self._total += self._measure(value)
            while self._total > self.limit:
                self._total -= self._measure(self._values.popitem(last=False)[1])

    def get(self, key: K, compute: Callable[[], V]) -> V:
        """The value of ``key``, kept or computed; it is computed without the lock, maybe by several threads at once."""
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        self[key] = value = compute()
        return value

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._values.clear()
            self._total = 0

    def _measure(self, value: V) -> int:
        return 1 if self._size is None else self._size(value)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.limit, self._size)
