"""Correspondences that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.correspondence import ToyCorrespondence


class Channels(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        return replace(flow, displacement=flow.displacement.movedim(1, -1))


class Offset(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        return replace(flow, displacement=flow.displacement + 0.7)


class Strict(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        return replace(flow, visible=flow.visible & (flow.displacement.abs().amax(1) > 1e-3))


class RowsFirst(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        return replace(flow, displacement=flow.displacement.flip(1))


class Boundless(ToyCorrespondence):
    def __init__(self):
        super().__init__(margin=-1000.0)


class FirstPair(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        brightness = source.images.mean() - source.images.mean((1, 2, 3))
        return replace(flow, displacement=flow.displacement + 5 * brightness[:, None, None, None])


class Rough(ToyCorrespondence):
    def __call__(self, source, target):
        if source.depth is None:
            return source.depth * 1.0
        return super().__call__(source, target)


class Overwriting(ToyCorrespondence):
    def __call__(self, source, target):
        flow = super().__call__(source, target)
        source.images.mul_(torch.tensor(0.9))
        return flow


class Halved(ToyCorrespondence):
    def displacement(self, source, target):
        return 0.5 * super().displacement(source, target)


CHANGED = {
    "as it is": (ToyCorrespondence, set()),
    "channels last": (Channels, {"flow has the frames shape"}),
    "off by some": (Offset, {"nothing moved is no flow"}),
    "too strict": (Strict, {"nothing moved is no flow"}),
    "y before x": (RowsFirst, {"moved cameras are followed"}),
    "beyond the frame": (Boundless, {"what left the frame is not visible"}),
    "pairs mixed": (FirstPair, {"pairs are independent"}),
    "another flow when asked for that alone": (Halved, {"displacement alone is the flows"}),
    "frames overwritten": (Overwriting, {"pairs are independent"}),
    "an error of its own": (Rough, {"missing knowledge is said"}),
}
