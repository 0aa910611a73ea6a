"""Trainings that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.training import ToyTraining


class Nothing(ToyTraining):
    def exports(self):
        return {}


class Badly(ToyTraining):
    def exports(self):
        return {"the backbone": self.backbone}


class Wandering:
    def __init__(self, source):
        self.source = source

    def batch(self, step, rank, world):
        given = self.source.batch(step, rank, world)
        return replace(given, views=given.views.map(lambda tensor: tensor * torch.rand(())))


class ByChance(ToyTraining):
    def batches(self, scenes, styles, *, seed):
        return Wandering(super().batches(scenes, styles, seed=seed))


class Wordy(ToyTraining):
    def batches(self, scenes, styles, *, seed):
        if scenes is None:
            raise ValueError("scenes\nare missing")
        return super().batches(scenes, styles, seed=seed)


class Idle(ToyTraining):
    def training_step(self, batch, step):
        return super().training_step(batch, step) * 0


class Exploding(ToyTraining):
    def training_step(self, batch, step):
        return super().training_step(batch, step) * float("inf")


class Restless(ToyTraining):
    source = torch.Generator().manual_seed(0)

    def training_step(self, batch, step):
        return super().training_step(batch, step) * (1 + torch.rand((), generator=self.source))


CHANGED = {
    "as it is": (ToyTraining, set()),
    "nothing to export": (Nothing, {"exports what it teaches"}),
    "a name with a space": (Badly, {"exports what it teaches"}),
    "batches by chance": (ByChance, {"batches are functions of the step"}),
    "an error of two lines": (Wordy, {"missing sources are said"}),
    "nothing learned": (Idle, {"steps teach what is exported"}),
    "no finite weights": (Exploding, {"steps teach what is exported"}),
    "chance of its own": (Restless, {"learning is reproducible"}),
}
