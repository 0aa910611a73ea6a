"""Methods that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.methods.contract import Progress, silent
from anystyle.testing.toy.method import ToyMethod


def changing(change):
    """A method whose Gaussians are changed by a function."""

    class Changed(ToyMethod):
        def __call__(self, *given, **rest):
            return change(super().__call__(*given, **rest))

    return Changed


class Painting(ToyMethod):
    def __call__(self, stylizer, scene, style, embedding, *, on_progress=silent):
        result = super().__call__(stylizer, scene, style, embedding)
        scene.views.images.mul_(0.5)
        return result


class Random(ToyMethod):
    count = 0

    def __call__(self, *given, **rest):
        Random.count += 1
        result = super().__call__(*given, **rest)
        return replace(result, opacities=result.opacities / (1 + 1e-3 * Random.count))


class Hesitant(ToyMethod):
    def __call__(self, *given, **rest):
        if not torch.is_grad_enabled():
            raise RuntimeError("element 0 of tensors does not require grad")
        return super().__call__(*given, **rest)


class Wordy(ToyMethod):
    def __call__(self, stylizer, scene, style, embedding, *, on_progress=silent):
        if style.image is None:
            raise ValueError("there is no image\ngive one")
        return super().__call__(stylizer, scene, style, embedding)


class Dazzling(ToyMethod):
    def __call__(self, stylizer, scene, style, embedding, *, on_progress=silent):
        on_progress(Progress("half way", 255 * scene.views.images[0, 0]))
        return super().__call__(stylizer, scene, style, embedding)


def _lost(gaussians):
    return replace(gaussians, opacities=gaussians.opacities * float("nan"))


CHANGED = {
    "as it is": (ToyMethod, set()),
    "not a number": (changing(_lost), {"gives gaussians"}),
    "with gradients": (changing(lambda g: g.map(lambda t: t.requires_grad_())), {"gives gaussians"}),
    "writes into the scene": (Painting, {"leaves the scene alone"}),
    "another each time": (Random, {"gives the same twice"}),
    "needs gradients on": (Hesitant, {"works where gradients are off"}),
    "two lines": (Wordy, {"says in a line that a style lacks something"}),
    "thumbnail of bytes": (Dazzling, {"progress can be shown"}),
}
