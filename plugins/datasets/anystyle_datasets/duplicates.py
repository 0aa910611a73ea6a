"""Pictures of one folder that show the same as pictures of another, whatever their names, sizes and formats."""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image

from anystyle.data.images import open_image
from anystyle.errors import UserError

SAME = 10
"""Bits of 256 that two copies of one picture may differ in; unrelated ones differ in about 128."""


def fingerprint(path: Path) -> int:
    """256 bits: whether each of 16 x 16 parts of a picture is darker than its neighbour to the right."""
    small = open_image(path, longest=256).convert("L").resize((17, 16), Image.Resampling.LANCZOS)
    gray = np.asarray(small, dtype=np.int16)
    return int.from_bytes(np.packbits(gray[:, 1:] > gray[:, :-1]).tobytes(), "big")


def same_pictures(paths: Sequence[Path], others: Iterable[Path]) -> Mapping[Path, Path]:
    """For each file that shows the same as one of ``others``, the first such one; unreadable files match nothing."""
    known = _fingerprints(others)
    matches: dict[Path, Path] = {}
    for path, bits in _fingerprints(paths):
        match = next((other for other, other_bits in known if (bits ^ other_bits).bit_count() <= SAME), None)
        if match is not None:
            matches[path] = match
    return matches


def _fingerprints(paths: Iterable[Path]) -> list[tuple[Path, int]]:
    def found(path: Path) -> list[tuple[Path, int]]:
        try:
            return [(path, fingerprint(path))]
        except (UserError, OSError):
            return []

    with ThreadPoolExecutor(4) as pool:
        return [pair for pairs in pool.map(found, paths) for pair in pairs]
