"""Sources of scenes that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.scenes import ToyScenes


class Nameless(ToyScenes):
    def name(self, scene):
        return "wall"


class Empty(ToyScenes):
    def __len__(self):
        return 0


class Bytes(ToyScenes):
    def read(self, scene, views):
        given = super().read(scene, views)
        return replace(given, images=(255 * given.images).round())


class Scaled(ToyScenes):
    def read(self, scene, views):
        given = super().read(scene, views)
        return replace(given, depth=given.depth * (1 + 0.1 * len(views)))


class Numbered(ToyScenes):
    def read(self, scene, views):
        return replace(super().read(scene, views), names=tuple(str(place) for place in range(len(views))))


class Random(ToyScenes):
    def read(self, scene, views):
        given = super().read(scene, views)
        return replace(given, images=(given.images + 0.01 * torch.rand(1, 1, 3, 1, 1)).clamp(0, 1))


class Handle(ToyScenes):
    def __init__(self):
        super().__init__()
        self.stream = (number for number in range(3))


CHANGED = {
    "as it is": (ToyScenes, set()),
    "one name": (Nameless, {"scenes are counted and named"}),
    "no scene": (Empty, {"scenes are counted and named"}),
    "8-bit values": (Bytes, {"views are images with what is known"}),
    "a scale of the selection": (Scaled, {"any view can be read"}),
    "names by place": (Numbered, {"any view can be read"}),
    "chance": (Random, {"any view can be read", "reading twice is the same"}),
    "an open stream": (Handle, {"reading twice is the same"}),
}
