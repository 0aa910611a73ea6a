"""Losses that each break one promise, and what is found."""

import torch

from anystyle.testing.toy.loss import ToyLoss


class Weightless(ToyLoss):
    def __init__(self):
        super().__init__()
        self.weight = None


class PerView(ToyLoss):
    def forward(self, result):
        return (result.renders.color.mean((2, 3, 4)) - result.views.images.mean((2, 3, 4))).square()


class Double(ToyLoss):
    def forward(self, result):
        return super().forward(result).double()


class ForOneScene(ToyLoss):
    def forward(self, result):
        return super().forward(result) * result.renders.color.sum((1, 2, 3, 4)).reshape(())


class NeedsAnImage(ToyLoss):
    def forward(self, result):
        return super().forward(result) + result.style.image.mean()


class ReadsAbsentImages(ToyLoss):
    def forward(self, result):
        if result.style.image is None:
            return super().forward(result)
        return (result.renders.color.mean() - result.style.image.mean()).square()


class Wandering(ToyLoss):
    def __init__(self):
        super().__init__()
        self.source = torch.Generator().manual_seed(0)

    def forward(self, result):
        return super().forward(result) * torch.rand((), generator=self.source)


class Overwriting(ToyLoss):
    def forward(self, result):
        with torch.no_grad():
            result.renders.color.mul_(0.9)
        return super().forward(result)


class Detached(ToyLoss):
    def forward(self, result):
        return super().forward(result.detach())


class Explosive(ToyLoss):
    def forward(self, result):
        return (super().forward(result.detach()) * 0 + (result.renders.color * 0).sum()).sqrt()


CHANGED = {
    "as it is": (ToyLoss, set()),
    "no weight": (Weightless, {"weight is a number"}),
    "a number a view": (PerView, {"value is one finite number"}),
    "in double precision": (Double, {"value is one finite number"}),
    "for one scene": (ForOneScene, {"value is one finite number"}),
    "needs an image": (NeedsAnImage, {"styles may lack a part", "absent images are not read"}),
    "reads what is absent": (ReadsAbsentImages, {"absent images are not read"}),
    "chance without a seed": (Wandering, {"value is reproducible", "absent images are not read"}),
    "renders overwritten": (Overwriting, {"value is reproducible", "absent images are not read"}),
    "no gradient": (Detached, {"something learns from it"}),
    "a gradient that is not finite": (Explosive, {"something learns from it"}),
}
