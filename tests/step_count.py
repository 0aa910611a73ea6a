"""What a step of the Head variant holds and computes at the published depth, counted on tensors without memory.

``python tests/step_count.py --height 224 --width 448 --views 4`` runs the whole network forth and back on fake tensors,
once as the training does and once with the backbone differentiated too and all terms at the end. It counts the largest
sum of bytes that are alive together (weights, gradients and the optimiser's averages included) and the multiplications.
Nothing is measured: no interpreter, no allocator, and of the renderer only that it hands gradients to every attribute.
Times of machines are ``step_cost.py``'s.
"""

import argparse
import copy
import sys
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from anystyle import perception
from anystyle.branch import StyleBranch
from anystyle.inference.memory import PeakMemory
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.losses import clip_patch, content, style
from anystyle.losses.clip_directional import ClipDirectional
from anystyle.losses.clip_patch import ClipPatch
from anystyle.losses.content import Content
from anystyle.losses.depth_consistency import DepthConsistency
from anystyle.losses.style import Style as StyleLoss
from anystyle.perception.eager_backward import eager_backward
from anystyle.style_encoders.long_clip import LongClip
from anystyle.types import Cameras, Gaussians, Renders, Style, StyleEmbedding, Stylization, Views
from anystyle_anysplat.backbone import AnySplat


def rendered(gaussians: Gaussians, cameras: Cameras) -> Renders:
    """Pictures that depend on every attribute of every Gaussian, at no cost."""
    views, (height, width) = cameras.intrinsics.shape[1], cameras.size
    shape = (gaussians.means.shape[0], views, height, width)
    solid = gaussians.opacities
    for attribute in (gaussians.means, gaussians.scales, gaussians.rotations):
        solid = solid + attribute.mean(-1)
    color = (gaussians.harmonics[..., 0, :] * solid[..., None]).reshape(*shape, 3).movedim(-1, 2)
    return Renders(color, solid.reshape(shape), solid.reshape(shape))


def without_memory(module: nn.Module) -> nn.Module:
    """A copy on fake tensors of the processor; call it within their mode."""
    memo: dict[int, object] = {}
    for parameter in module.parameters():
        fake = torch.empty(parameter.shape, dtype=parameter.dtype, device="cpu")
        memo[id(parameter)] = nn.Parameter(fake, requires_grad=parameter.requires_grad)
    for buffer in module.buffers():
        memo[id(buffer)] = torch.empty(buffer.shape, dtype=buffer.dtype, device="cpu")
    return copy.deepcopy(module, memo)


class Step(nn.Module):
    """The networks of a step: what the training holds."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = AnySplat(fuse=False)
        self.branch = StyleBranch(
            self.backbone,
            sites=self.backbone.gaussian_head.sites,
            make_injector=lambda site: ZeroConv(dim=site.dim, style_dim=512),
        )
        self.vgg, self.encoder = perception.VGG19().requires_grad_(False), LongClip().requires_grad_(False)


def count(*, size: tuple[int, int], views: int, straightforward: bool) -> tuple[int, int]:
    """Bytes and multiplications of a step of one scene."""
    with torch.device("meta"):
        plain = Step()
    with FakeTensorMode(allow_non_fake_inputs=True):
        step = without_memory(plain)
        assert isinstance(step, Step)
        step.backbone.requires_grad_(straightforward)
        terms = objective(step, early=not straightforward)
        images = torch.empty(1, views, 3, *size)
        vector = torch.empty(1, 512)
        weights = [*step.parameters(), *step.buffers()]
        with PeakMemory(weights) as followed, FlopCounterMode(display=False) as flops:
            with torch.set_grad_enabled(straightforward):
                scene = step.backbone.encode(Views(images))
            attributes = scene.attributes.with_(step.branch(scene, StyleEmbedding(vector, vector)), step.branch.styled)
            gaussians = step.backbone.adapter(attributes, scene.geometry, scene.clusters)
            renders = rendered(gaussians, scene.geometry.cameras)
            painted = Style(image=torch.empty(1, 3, 256, 256))
            result = Stylization(scene.views, painted, StyleEmbedding(vector, vector), scene, gaussians, renders)
            total: Tensor = sum((term.weight * term(result) for term in terms), torch.zeros(()))
            total.backward()
        held = sum(weight.numel() * weight.element_size() for weight in weights)
        averages = 2 * sum(parameter.numel() * parameter.element_size() for parameter in step.branch.parameters())
        return held + averages + followed.peak, flops.get_total_flops()


def objective(step: Step, *, early: bool) -> list[nn.Module]:
    """The published terms; where crops lie does not matter, and is not asked of tensors without values."""
    for module in (clip_patch, content, style):
        module.eager_backward = eager_backward if early else lambda function, images: function(images)
    before, perception.load = perception.load, lambda name: step.vgg  # pyright: ignore[reportAttributeAccessIssue]
    try:
        terms: list[nn.Module] = [Content(), StyleLoss()]
    finally:
        perception.load = before
    patch = ClipPatch(style_encoder=step.encoder)
    patch._patches = lambda images, generator: images[..., :64, :64].clone()
    return [*terms, ClipDirectional(style_encoder=step.encoder), patch, DepthConsistency()]


def main(words: Sequence[str]) -> None:
    """Read the size, count both, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--height", type=int, default=224)
    parser.add_argument("--width", type=int, default=448)
    parser.add_argument("--views", type=int, default=4)
    given = parser.parse_args(words)
    ours, plain = (
        count(size=(given.height, given.width), views=given.views, straightforward=straightforward)
        for straightforward in (False, True)
    )
    for name, mine, other, unit in (("gigabytes", ours[0], plain[0], 1e9), ("teraflops", ours[1], plain[1], 1e12)):
        sys.stdout.write(f"{name:<10} {mine / unit:.4g} of {other / unit:.4g}: {mine / other:.3f}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
