"""The least-recently-used cache."""

import pickle

from hypothesis import given
from hypothesis import strategies as st

from anystyle.io.cache import LRUCache


@given(st.lists(st.integers(0, 6), max_size=40), st.integers(0, 5))
def test_values_are_right_and_the_most_recently_used_are_kept(keys, limit):
    """What is computed is what a least-recently-used cache has to compute."""
    cache, computed, recent, expected = LRUCache(limit), [], [], []
    for key in keys:
        assert cache.get(key, lambda key=key: computed.append(key) or key * key) == key * key
        if key not in recent:
            expected.append(key)
        recent = [*(other for other in recent if other != key), key][-limit:] if limit else []
        assert [other for other in range(7) if other in cache] == sorted(recent)
    assert computed == expected


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(1, 9)), max_size=30))
def test_sizes_stay_within_the_limit_and_only_the_oldest_go(values):
    cache, kept = LRUCache(12, len), {}
    for key, size in values:
        cache[key] = "x" * size
        kept.pop(key, None)
        kept[key] = size
        while sum(kept.values()) > 12:
            del kept[next(iter(kept))]
        assert {key: len(cache[key]) for key in list(kept)} == kept
        assert all(key in kept for key in range(5) if key in cache)


def test_a_copy_starts_empty_and_so_does_one_that_was_cleared():
    cache = LRUCache(3, len)
    cache["a"] = "abc"
    copy = pickle.loads(pickle.dumps(cache))
    assert "a" in cache and "a" not in copy
    copy["b"] = "bcde"
    assert "b" not in copy
    cache.clear()
    assert "a" not in cache
