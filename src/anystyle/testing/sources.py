"""What sources of scenes and of styles promise alike: their number, their pixels, and reading without a memory."""

import pickle
from collections.abc import Iterator, Sized
from typing import TypeVar

import torch
from torch import Tensor

from anystyle.testing.check import attempt, expect
from anystyle.testing.subject import Subject

Source = TypeVar("Source", bound=Sized)

MOST = 3
"""Scenes or styles that are looked at; a source may have thousands."""


def expect_any(source: Sized, what: str) -> None:
    """Refuse a source that has nothing."""
    expect(
        len(source) >= 1,
        given=f"no {what}",
        expected="at least one",
        change="raise a ValueError in the constructor where the folder is empty, or return a sample from `example`",
    )


def expect_srgb(images: Tensor, where: str) -> None:
    """Refuse pixels that are not float32 sRGB in [0, 1] on the CPU."""
    low, high = float(images.min()), float(images.max())
    expect(
        low >= 0 and high <= 1 and images.device.type == "cpu" and images.dtype == torch.float32,
        given=f"{where}: {images.dtype} images from {low:.3g} to {high:.3g} on {images.device}",
        expected="float32 sRGB in [0, 1] on the CPU",
        change="divide 8-bit values by 255",
    )


def copies(plugin: Subject[Source]) -> Iterator[tuple[str, Source]]:
    """The source itself, its copy in a worker, and a new instance."""
    source = plugin.instance
    with attempt("pickling the source", change="open files when they are read, and keep no handles or generators"):
        copied = pickle.loads(pickle.dumps(source))
    yield from (("this source", source), ("a pickled copy", copied), ("a new instance", plugin.build(seed=1)))
