"""Protocols that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.protocol import ToyProtocol


class Empty(ToyProtocol):
    def run(self, out, progress):
        return replace(super().run(out, progress), figures={})


class Whole(ToyProtocol):
    def run(self, out, progress):
        return replace(super().run(out, progress), figures={"contrast_change": 1})


class Spaced(ToyProtocol):
    def run(self, out, progress):
        found = super().run(out, progress)
        return replace(found, groups={"baseline": {"contrast change": 1.0}})


class Better(ToyProtocol):
    def run(self, out, progress):
        return replace(super().run(out, progress), better={"something_else": "lower"})


class Uncounted(ToyProtocol):
    def run(self, out, progress):
        return replace(super().run(out, progress), n=0)


class Bulky(ToyProtocol):
    def run(self, out, progress):
        return replace(super().run(out, progress), provenance={"mean": torch.zeros(3)})


class Mute(ToyProtocol):
    def run(self, out, progress):
        return super().run(out, lambda stage, done, total: progress("", done, total))


class Restless(ToyProtocol):
    source = torch.Generator().manual_seed(0)

    def run(self, out, progress):
        found = super().run(out, progress)
        chance = float(torch.rand((), generator=self.source))
        return replace(found, figures={"contrast_change": found.figures["contrast_change"] + chance})


class Forgetful(ToyProtocol):
    def run(self, out, progress):
        # What an interrupted run left is taken for that of a finished one.
        with (out / "runs").open("a") as file:
            file.write("one\n")
        found = super().run(out, progress)
        return replace(found, figures={"runs": float(len((out / "runs").read_text().splitlines()))}, better={})


class Careless(ToyProtocol):
    def __init__(self, *, stylizer, scenes, styles):
        super().__init__(stylizer=stylizer, scenes=scenes, styles=styles[:3] if styles is None else styles)


CHANGED = {
    "as it is": (ToyProtocol, set()),
    "no figure": (Empty, {"figures are numbers"}),
    "an integer": (Whole, {"figures are numbers"}),
    "a name with a space": (Spaced, {"figures are numbers"}),
    "a figure that is not there": (Better, {"figures are numbers"}),
    "nothing counted": (Uncounted, {"it says what figures rest on"}),
    "tensors in the provenance": (Bulky, {"it says what figures rest on"}),
    "no stage": (Mute, {"it tells how far it is"}),
    "chance": (Restless, {"it is reproducible", "it goes on where it was stopped"}),
    "half is taken for whole": (Forgetful, {"it goes on where it was stopped"}),
    "no source": (Careless, {"missing sources are said"}),
}
