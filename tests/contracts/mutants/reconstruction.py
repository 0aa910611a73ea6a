"""Reconstructions that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.reconstruction import ToyReconstruction
from anystyle.types import Reconstructed


def changing(**change):
    """A reconstruction whose scene differs in some fields, each given as a function of the scene."""

    class Changed(ToyReconstruction):
        def __call__(self, views, encode, renderer, **rest):
            scene, measures = super().__call__(views, encode, renderer, **rest)
            return Reconstructed(replace(scene, **{name: new(scene) for name, new in change.items()}), measures)

    return Changed


class Blind(ToyReconstruction):
    def __call__(self, views, encode, renderer, **rest):
        if views.cameras is None:
            return Reconstructed(encode(views), {})
        return super().__call__(views, encode, renderer, **rest)


class Writing(ToyReconstruction):
    def __call__(self, views, encode, renderer, **rest):
        result = super().__call__(views, encode, renderer, **rest)
        views.images.mul_(0.5)
        return result


class Unmeasured(ToyReconstruction):
    def __call__(self, views, encode, renderer, **rest):
        scene, _ = super().__call__(views, encode, renderer, **rest)
        return Reconstructed(scene, {"heldout_psnr": float("nan")})


class Random(ToyReconstruction):
    count = 0

    def __call__(self, views, encode, renderer, **rest):
        Random.count += 1
        scene, measures = super().__call__(views, encode, renderer, **rest)
        moved = replace(scene.gaussians, opacities=scene.gaussians.opacities / (1 + 1e-3 * Random.count))
        return Reconstructed(replace(scene, gaussians=moved), measures)


def _one_view(scene):
    shown = scene.geometry
    return replace(shown, depth=shown.depth[:, :1], confidence=shown.confidence[:, :1])


def _moved(scene):
    seen = scene.geometry.cameras
    poses = seen.world_from_camera.clone()
    poses[..., 0, 3] += 1
    return replace(scene.geometry, cameras=replace(seen, world_from_camera=poses))


CHANGED = {
    "as it is": (ToyReconstruction, set()),
    "depth of one view": (changing(geometry=_one_view), {"makes a scene of the views"}),
    "origins outside": (
        changing(origins=lambda scene: scene.origins + torch.tensor([0, 0, 4])),
        {"origins are pixels of the views"},
    ),
    "another frame": (changing(geometry=_moved), {"keeps cameras that are known"}),
    "no word of cameras": (Blind, {"says that cameras are missing"}),
    "writes into images": (Writing, {"leaves the views alone"}),
    "not a number": (Unmeasured, {"measures are finite"}),
    "another each time": (Random, {"gives the same twice"}),
}
