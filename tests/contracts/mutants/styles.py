"""Sources of styles that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.styles import ToyStyles


class Empty(ToyStyles):
    def read(self, style):
        return replace(super().read(style), image=None, text=None)


class Sizes(ToyStyles):
    def read(self, style):
        given = super().read(style)
        return replace(given, image=given.image[..., : self.size - style])


class Unbatched(ToyStyles):
    def read(self, style):
        given = super().read(style)
        return replace(given, image=given.image.expand(2, -1, -1, -1))


class Random(ToyStyles):
    def read(self, style):
        given = super().read(style)
        return replace(given, image=(given.image * torch.rand(())).clamp(0, 1))


class Drifting(ToyStyles):
    def read(self, style):
        self.reads = getattr(self, "reads", 0) + 1
        return replace(super().read(style), text=(f"style {self.reads}",))


CHANGED = {
    "as it is": (ToyStyles, set()),
    "neither image nor text": (Empty, {"styles have an image or a text"}),
    "many sizes": (Sizes, {"styles have an image or a text"}),
    "a batch of two": (Unbatched, {"styles have an image or a text"}),
    "chance": (Random, {"reading twice is the same"}),
    "other texts": (Drifting, {"reading twice is the same"}),
}
