"""Names of files: which of those that are there one means, and the numbers of frames in their sequence."""

import re
import unicodedata
from collections.abc import Iterable, Sequence
from itertools import pairwise


class Names:
    """Finds the names that are meant by others.

    A name that is there means itself. Another means all that differ from it only in upper and lower case, Unicode
    form and the zeros before a number: ``frame_3`` means ``Frame_003``.

    Example:
        >>> Names(["Frame_003", "frame_4", "a_1", "a_01"]).find("frame_3")
        ['Frame_003']
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._known: dict[str, str] = {name: name for name in names}
        self._alike: dict[str, list[str]] = {}
        for name in self._known:
            self._alike.setdefault(folded(name), []).append(name)

    def find(self, name: str) -> list[str]:
        """The names that ``name`` means: several if they are alike, none if it means nothing."""
        return [name] if name in self._known else self._alike.get(folded(name), [])


def folded(name: str) -> str:
    """A form that names share which mean the same."""
    name = unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())
    return re.sub(r"(?<![0-9])0+(?=[0-9])", "", name)


def splits(stem: str, separators: str = "_") -> list[tuple[str, str]]:
    """Both parts of a name at each separator that has something on both sides, from the left.

    Example:
        >>> splits("van_gogh_1")
        [('van', 'gogh_1'), ('van_gogh', '1')]
    """
    return [(stem[:cut], stem[cut + 1 :]) for cut in range(1, len(stem) - 1) if stem[cut] in separators]


def sequence(names: Sequence[str]) -> tuple[int, ...]:
    """The number of each frame in its sequence, from 0, from the names of all its frames in order.

    Where at least half of the numbers at the end of otherwise equal names follow in one step, larger steps skip frames.
    Otherwise each frame follows the one before it.

    Example:
        >>> sequence(["frame_010", "frame_020", "frame_040", "frame_050"]), sequence(["a", "b"])
        ((0, 1, 3, 4), (0, 1))
    """
    parts = [re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", name, re.DOTALL) for name in names]
    numbers = [int(part[2]) for part in parts if part]
    steps = [second - first for first, second in pairwise(numbers)]
    step = min(steps, default=0)
    alike = None not in parts and len({(part[1], part[3]) for part in parts if part}) == 1
    if not alike or step < 1 or 2 * steps.count(step) < len(steps) or any(one % step for one in steps):
        return tuple(range(len(names)))
    return tuple((number - numbers[0]) // step for number in numbers)
