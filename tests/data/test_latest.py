import pickle

from hypothesis import given
from hypothesis import strategies as st

from anystyle.data.latest import Latest


def square(value):
    CALLS.append(value)
    return value * value


CALLS: list[int] = []


@given(st.lists(st.integers(0, 6), max_size=40), st.integers(1, 5))
def test_results_are_right_and_the_latest_are_kept(values, count):
    """The calls that are made are those of a least-recently-used cache."""
    CALLS.clear()
    latest, recent, expected = Latest(square, count), [], []
    for value in values:
        assert latest(value) == value * value
        if value not in recent:
            expected.append(value)
        recent = [*(other for other in recent if other != value), value][-count:]
    assert expected == CALLS


def test_a_copy_starts_empty():
    class_level = Latest(len, 3)
    assert class_level("abc") == 3
    assert pickle.loads(pickle.dumps(class_level))("abcd") == 4
