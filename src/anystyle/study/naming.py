"""Names of pictures that tell a participant nothing, and the experimenter's files everything."""

import numpy as np

_OFFSET, _PRIME = 2166136261, 16777619


def checksum(text: str) -> int:
    """The 32-bit FNV-1a hash of ASCII text; the form's script computes the same."""
    value = _OFFSET
    for byte in text.encode("ascii"):
        value = ((value ^ byte) * _PRIME) % 2**32
    return value


def is_ours(name: str, identity: str) -> bool:
    """Whether a picture of a study is by ours.

    The page has to put this into the answers it exports and must not show it: the parity of a checksum of the study's
    identity and the picture's name is enough for that and looks like nothing.
    """
    return checksum(identity + name) >> 8 & 1 == 1


def picture_name(generator: np.random.Generator, identity: str, *, ours: bool | None) -> str:
    """A random name for a picture by ours (``True``), by another method (``False``) or by neither (``None``)."""
    while True:
        name = generator.bytes(6).hex()
        if ours is None or is_ours(name, identity) == ours:
            return name
