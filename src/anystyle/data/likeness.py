"""Whether two files show the same picture, whatever they are called, however large they are."""

from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image

from anystyle.data.images import open_image

SAME = 10
"""Bits of 256 that two copies of one picture may differ in; unrelated ones differ in about 128."""


def fingerprint(path: Path) -> int:
    """256 bits: whether each of 16 x 16 parts of a picture is darker than its neighbour to the right.

    Raises:
        ValueError: It is no image, or a damaged one.
    """
    small = open_image(path, longest=256).convert("L").resize((17, 16), Image.Resampling.LANCZOS)
    grey = np.asarray(small, dtype=np.int16)
    return int.from_bytes(np.packbits(grey[:, 1:] > grey[:, :-1]).tobytes(), "big")


def same_pictures(paths: Iterable[Path], others: Iterable[Path]) -> Mapping[Path, Path]:
    """For each file that shows what one of ``others`` shows, the first such one; unreadable files match nothing."""
    known = [(print_, path) for path, print_ in _fingerprints(others)]
    matches: dict[Path, Path] = {}
    for path, print_ in _fingerprints(paths):
        match = next((other for known_print, other in known if (print_ ^ known_print).bit_count() <= SAME), None)
        if match is not None:
            matches[path] = match
    return matches


def _fingerprints(paths: Iterable[Path]) -> list[tuple[Path, int]]:
    every = list(paths)
    with ThreadPoolExecutor(4) as pool:
        prints = list(pool.map(_try, every))
    return [(path, print_) for path, print_ in zip(every, prints, strict=True) if print_ is not None]


def _try(path: Path) -> int | None:
    try:
        return fingerprint(path)
    except (ValueError, OSError):
        return None
