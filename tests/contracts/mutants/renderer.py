"""Renderers that each break one promise, and what is found."""

from dataclasses import replace

import torch

from anystyle.testing.toy.renderer import ToyRenderer


class OneScene(ToyRenderer):
    def __call__(self, gaussians, cameras):
        return super().__call__(gaussians.map(lambda tensor: tensor[:1]), cameras)


class Bright(ToyRenderer):
    def __call__(self, gaussians, cameras):
        renders = super().__call__(gaussians, cameras)
        return replace(renders, color=renders.color * 1.5)


class Hazy(ToyRenderer):
    def __call__(self, gaussians, cameras):
        renders = super().__call__(gaussians, cameras)
        return replace(renders, alpha=renders.alpha.clamp_min(0.01))


class Averaging(ToyRenderer):
    def __call__(self, gaussians, cameras):
        shown = gaussians.opacities * 20 / gaussians.opacities.shape[1]
        return super().__call__(replace(gaussians, opacities=shown.clamp(0, 1)), cameras)


class Ranked(ToyRenderer):
    def __call__(self, gaussians, cameras):
        shade = 1 - 0.1 * torch.arange(gaussians.means.shape[1])[None, :, None, None].clamp(max=5)
        return super().__call__(replace(gaussians, harmonics=gaussians.harmonics * shade), cameras)


class FirstScenesBackground(ToyRenderer):
    def __call__(self, gaussians, cameras):
        renders = super().__call__(gaussians, cameras)
        return replace(renders, depth=renders.depth + renders.alpha * 0 + 0.1 * renders.alpha.mean(0, keepdim=True))


class Shifted(ToyRenderer):
    def __call__(self, gaussians, cameras):
        intrinsics = cameras.intrinsics + torch.tensor([[0.0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        return super().__call__(gaussians, replace(cameras, intrinsics=intrinsics))


class FarFirst(ToyRenderer):
    def _draw(self, gaussians, cameras, scene, view):
        image = super()._draw(gaussians, cameras, scene, view)
        pose = cameras.camera_from_world[scene, view]
        depth = gaussians.means[scene] @ pose[2, :3]
        far = depth.argsort(descending=True)[:1]
        behind = super()._draw(gaussians.map(lambda tensor: tensor[:, far]), cameras, scene, view)
        return image * (1 - behind[4]) + behind


class Unnormalised(ToyRenderer):
    def __call__(self, gaussians, cameras):
        norm = gaussians.rotations.norm(dim=-1, keepdim=True)
        return super().__call__(replace(gaussians, scales=gaussians.scales * norm), cameras)


class Trembling(ToyRenderer):
    calls = 0

    def __call__(self, gaussians, cameras):
        self.calls += 1
        return super().__call__(replace(gaussians, means=gaussians.means + 1e-6 * self.calls), cameras)


class Detached(ToyRenderer):
    def __call__(self, gaussians, cameras):
        return super().__call__(replace(gaussians, rotations=gaussians.rotations.detach()), cameras)


CHANGED = {
    "as it is": (ToyRenderer, set()),
    "the first scene alone": (OneScene, {"renders every camera"}),
    "colours above 1": (Bright, {"renders every camera"}),
    "alpha everywhere": (
        Hazy,
        {"empty scenes show the background", "points appear where they project"},
    ),
    "fewer are denser": (Averaging, {"padding is invisible"}),
    "the later, the darker": (Ranked, {"order does not matter", "near hides far"}),
    "scenes of a batch mixed": (FirstScenesBackground, {"batches are loops", "points appear where they project"}),
    "half a pixel off": (Shifted, {"points appear where they project"}),
    "far before near": (FarFirst, {"near hides far", "padding is invisible"}),
    "quaternions as scales": (Unnormalised, {"quaternions have any norm"}),
    "never the same twice": (Trembling, {"rendering twice is the same"}),
    "rotations without gradient": (Detached, {"everything carries gradients"}),
}
