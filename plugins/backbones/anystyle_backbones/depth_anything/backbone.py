"""The network: five parts, every option that its weights fix, and initial values for training without weights."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from anystyle import contracts
from anystyle.errors import UserError
from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn.attention import Block
from anystyle.nn.tokens import IMAGENET_MEAN, IMAGENET_STD
from anystyle.ranges import AtLeastOne
from anystyle_backbones import scratch as initial
from anystyle_backbones.aligner import Aligner
from anystyle_backbones.depth_anything.adapter import Adapter
from anystyle_backbones.depth_anything.heads import CameraDecoder, GaussianHead, direct_layers
from anystyle_backbones.depth_anything.transformer import Aggregator, Embedder
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import GeometryHead, check_options
from anystyle_backbones.reference_view import Strategy


class DepthAnything(contracts.Backbone):
    """Cameras, depth and one Gaussian per pixel of photographs, in one pass (Depth Anything 3, arXiv 2511.10647).

    The defaults are the largest published network, DA3-GIANT of 1.36 billion parameters, the only one with a Gaussian
    head. The published weights fix every option but ``reference``, ``chunk`` and ``checkpointing``.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for; published pictures have a longer side of
            504, which at 4:3 is this.
        patch_size: Pixels per patch; image sides are multiples of it.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        dim: Channels of the trunk.
        depth: Blocks of the trunk.
        heads: Attention heads of the trunk.
        ffn: Feed-forward layers of the trunk.
        mlp_ratio: Their width, in channels; gated ones have two thirds of it.
        layer_scale: Initial LayerScale of the trunk.
        alternate_from: The block that the aggregator starts with: from here on every odd block sees all views.
        rope_base: Base of the frequencies of the rotary position embedding.
        reference: How the view is chosen that others are seen from, where there are three or more; see
            :func:`anystyle_backbones.reference_view.reference_view`.
        taps: The four layers that the heads read; the last is the trunk's last.
        poses: ``regressed`` from camera tokens, as published, or ``aligned`` by matching points with the reference's,
            which a network of a few million parameters can learn (see :class:`anystyle_backbones.aligner.Aligner`).
        trusted_cameras: Whether these poses are good enough to make a scene with; otherwise the cameras of photographs
            are estimated where that succeeds.
        depth_features: Channels of the depth head's decoder.
        depth_channels: Channels of its four levels.
        gaussian_features: Channels of the Gaussian head's decoder.
        gaussian_channels: Channels of its four levels.
        sh_degree: Degree of its spherical harmonics.
        depth_along: ``ray``: depth is the distance along the pixel's ray, as the published weights were trained;
            ``z``: along the camera's axis.
        rotations: ``published``: the entries of quaternions are permuted in world space, a side effect of the published
            code that its weights were trained with; ``camera``: they are xyzw in the camera's axes.
        scale_min: Least scale of a Gaussian, in tenths of the sum of a pixel's sides at its depth.
        scale_max: Largest scale, in the same unit.
        chunk: Views that the Gaussian head decodes at a time, the depth head twice as many; it affects only memory.
        checkpointing: Whether training recomputes blocks of the aggregator to save memory.
        init: ``published``: initial values as DINOv2's; ``scratch``: values from which photographs are reproduced on
            a plane at depth 1, for training without pretrained weights (see
            :mod:`anystyle_backbones.scratch`). The computation is the same.
    """

    published = "anystyle_backbones.depth_anything.keys:DepthAnythingCheckpoints"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        trunk = {"depth": 8, "alternate_from": 3, "taps": (4, 5, 6, 7), "ffn": "mlp", "layer_scale": 0.5}
        return {**initial.SMALL_NETWORK, **trunk, "gaussian_features": 32}

    def __init__(
        self,
        *,
        resolution: int = 378,
        patch_size: int = 14,
        native_resolution: int = 518,
        dim: int = 1536,
        depth: int = 40,
        heads: int = 24,
        ffn: Literal["mlp", "swiglu"] = "swiglu",
        mlp_ratio: float = 4.0,
        layer_scale: float = 1.0,
        alternate_from: int = 13,
        rope_base: float = 100.0,
        reference: Strategy = "saddle_balanced",
        taps: Sequence[int] = (19, 27, 33, 39),
        poses: Literal["regressed", "aligned"] = "regressed",
        trusted_cameras: bool = True,
        depth_features: int = 256,
        depth_channels: Sequence[int] = (256, 512, 1024, 1024),
        gaussian_features: int = 256,
        gaussian_channels: Sequence[int] = (256, 512, 1024, 1024),
        sh_degree: int = 2,
        depth_along: Literal["ray", "z"] = "ray",
        rotations: Literal["published", "camera"] = "published",
        scale_min: float = 1e-5,
        scale_max: float = 30.0,
        chunk: AtLeastOne = 4,
        checkpointing: bool = False,
        init: Literal["published", "scratch"] = "published",
    ) -> None:
        super().__init__()
        if not 1 <= alternate_from < depth:
            raise UserError(f"alternate_from is {alternate_from}; give a block from 1 to depth - 1 = {depth - 1}")
        check_options(dim=dim, heads=heads, taps=taps, first=alternate_from, depth=depth)
        if init == "scratch" and gaussian_features < 24:
            raise UserError(f"gaussian_features is {gaussian_features}; init=scratch needs 24, for three colours")
        self.patch_size, self.resolution, self.trusted_cameras = patch_size, resolution, trusted_cameras
        block = partial(Block, dim, heads, ffn=ffn, mlp_ratio=mlp_ratio, layer_scale=layer_scale, eps=1e-6)
        grid, embedding = native_resolution // patch_size, (block() for _ in range(alternate_from))
        self.embedder = Embedder(dim, embedding, patch_size=patch_size, grid=grid, reference=reference)
        alternating = {layer: block(qk_norm=True) for layer in range(alternate_from, depth)}
        self.aggregator = Aggregator(dim, alternating, rope_base=rope_base, taps=taps, checkpointing=checkpointing)
        decoder = partial(Dpt, dim=2 * dim, hidden=32, rectified=False)
        self.geometry_head = GeometryHead(
            CameraDecoder(2 * dim),
            decoder(features=depth_features, channels=depth_channels, outputs=2),
            taps=taps,
            chunk=2 * chunk,
            aligner=Aligner() if poses == "aligned" else None,
        )
        outputs = 11 + 3 * (sh_degree + 1) ** 2
        dpt = decoder(features=gaussian_features, channels=gaussian_channels, outputs=outputs, normed=False)
        self.gaussian_head = GaussianHead(dpt, direct_layers(dpt.width), sh_degree=sh_degree, taps=taps, chunk=chunk)
        self.adapter = Adapter(depth_along=depth_along, rotations=rotations, scale_min=scale_min, scale_max=scale_max)
        if init == "scratch":
            start_geometry(self.embedder, self.geometry_head)
            start_gaussians(self.gaussian_head, scale_min=scale_min, scale_max=scale_max)


LIFT = 6.0
"""Added to normalised colours, so that GELU and ReLU pass them on as they are."""


@torch.no_grad()
def start_geometry(embedder: Embedder, geometry_head: GeometryHead) -> None:
    """Cameras at the origin and depth of about 1 (see :mod:`anystyle_backbones.scratch`)."""
    nn.init.normal_(embedder.cls_token, std=0.02)  # else layer norms see nothing but rounding
    decoder = geometry_head.camera
    assert isinstance(decoder, CameraDecoder)
    for layer in (decoder.translation, decoder.quaternion, decoder.field_of_view):
        nn.init.normal_(layer.weight, std=0.1 * initial.SMALL)
        nn.init.zeros_(layer.bias)
    decoder.quaternion.bias[3] = 1.0  # the real part of xyzw
    nn.init.constant_(decoder.field_of_view.bias, initial.FIELD_OF_VIEW)
    initial.start_small(geometry_head.depth.output[2])


@torch.no_grad()
def start_gaussians(head: GaussianHead, *, scale_min: float, scale_max: float) -> None:
    """Gaussians of their pixel's colour, about its footprint's size, of opacity 0.9, on the depth head's surface."""
    bias = initial.start_small(head.dpt.output[2])
    assert isinstance(head.direct, nn.Sequential)
    # The adapter's unit is a tenth of two pixels.
    fraction = (initial.PIXELS / 0.2 - scale_min) / (scale_max - scale_min)
    bias[2:5] = math.log(fraction / (1 - fraction))
    bias[8] = 1.0  # the real part of xyzw
    bias[-1] = initial.OPACITY_LOGIT
    for color, (carrier, _) in enumerate(initial.carriers(head.dpt.width)):
        initial.connect(head.direct[0], color, color, LIFT)
        initial.connect(head.direct[2], color, color, 0.0)
        initial.connect(head.direct[4], carrier, color, 0.0)
    offset = [(mean - std * LIFT - 0.5) / CONSTANT for mean, std in zip(IMAGENET_MEAN, IMAGENET_STD, strict=True)]
    initial.pass_colors_on(head.dpt, 9, head.coefficients, [std / CONSTANT for std in IMAGENET_STD], offset)
