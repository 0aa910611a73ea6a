"""The network: five parts, every option that its weights fix, and initial values for training without weights."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch import nn

from anystyle import contracts
from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn.attention import Block
from anystyle.ranges import AtLeastOne, Positive
from anystyle_backbones import scratch as initial
from anystyle_backbones.aligner import Aligner
from anystyle_backbones.anysplat.adapter import Adapter
from anystyle_backbones.anysplat.networks import Aggregator, CameraHead, DinoV2, Embedder, GaussianHead, Patches
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import GeometryHead, check_options
from anystyle_backbones.reference_view import Strategy


class AnySplat(contracts.Backbone):
    """Cameras, depth and one Gaussian per pixel of a set of photographs, in one pass (AnySplat, arXiv 2505.23716).

    The defaults are the published network of 1.19 billion parameters. The published weights fix every option but
    ``reference``, ``fuse``, ``sh_mode``, ``chunk`` and ``checkpointing``.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for.
        patch_size: Pixels per patch; image sides are multiples of it.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        embed: ``dino``, or ``conv`` for a linear embedding of patches.
        dim: Channels of the transformers.
        embed_depth: Blocks of the embedder.
        depth: Pairs of frame and global blocks.
        heads: Attention heads of the transformers.
        mlp_ratio: Width of all MLPs of transformers, in their channels.
        registers: Register tokens a view.
        rope_base: Base of the frequencies of the rotary position embedding.
        reference: How the view is chosen that others are seen from; as published, the first. See
            :func:`anystyle_backbones.reference_view.reference_view`.
        layer_scale: Initial LayerScale of the aggregator and the camera head.
        taps: The four layers that the heads read; the last is the aggregator's last.
        camera_depth: Blocks of the camera head.
        camera_heads: Its attention heads.
        camera_iterations: Its passes.
        poses: ``regressed`` from camera tokens, as published, or ``aligned`` by matching patches with the reference's,
            which a network of a few million parameters can learn (see :class:`anystyle_backbones.aligner.Aligner`).
        trusted_cameras: Whether these poses are good enough to make a scene with; otherwise the cameras of photographs
            are estimated where that succeeds.
        focal_epsilon: Added to the tangent of half a field of view where focal lengths are decoded.
        depth_features: Channels of the depth head's decoder.
        depth_channels: Channels of its four levels.
        depth_hidden: Channels of its last hidden layer.
        gaussian_features: Channels of the Gaussian head's decoder.
        gaussian_channels: Channels of its four levels.
        gaussian_hidden: Channels of its last hidden layer.
        sh_degree: Degree of its spherical harmonics.
        sh_mode: ``reference`` reproduces a side effect of the published code on styled colours; see
            :class:`anystyle_backbones.anysplat.adapter.Adapter`.
        pixel_center: Where in its pixel a point is seen; the published weights were trained with 0.
        fuse: Whether pixels that share a voxel become one Gaussian.
        voxel_size: Side of a voxel, in world units.
        scale_unit: World units of a Gaussian's scale a unit of softplus.
        scale_max: Largest scale, in world units.
        chunk: Views that the Gaussian head decodes at a time, the depth head twice as many; it affects only memory.
        checkpointing: Whether training recomputes blocks of the aggregator to save memory.
        init: ``published``: initial values as DINOv2's, VGGT's and AnySplat's; ``scratch``: values from which
            photographs are reproduced on a plane at depth 1, for training without pretrained weights (see
            :mod:`anystyle_backbones.scratch`). The computation is the same.
    """

    published = "anystyle_backbones.anysplat.keys:AnySplatCheckpoints"
    aggregator_type: ClassVar[type[Aggregator]] = Aggregator

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        depths = {"embed_depth": 1, "depth": 5, "taps": (1, 2, 3, 4), "camera_depth": 1, "camera_heads": 2}
        widths = {"depth_hidden": 8, "gaussian_features": 16, "gaussian_hidden": 8}
        return {**initial.SMALL_NETWORK, **depths, **widths, "voxel_size": 0.02, "scale_unit": 0.01}

    def __init__(
        self,
        *,
        resolution: int = 448,
        patch_size: int = 14,
        native_resolution: int = 518,
        embed: Literal["dino", "conv"] = "dino",
        dim: int = 1024,
        embed_depth: int = 24,
        depth: int = 24,
        heads: int = 16,
        mlp_ratio: float = 4.0,
        registers: int = 4,
        rope_base: float = 100.0,
        reference: Strategy = "first",
        layer_scale: float = 0.01,
        taps: Sequence[int] = (4, 11, 17, 23),
        camera_depth: int = 4,
        camera_heads: int = 16,
        camera_iterations: int = 4,
        poses: Literal["regressed", "aligned"] = "regressed",
        trusted_cameras: bool = True,
        focal_epsilon: float = 1e-3,
        depth_features: int = 256,
        depth_channels: Sequence[int] = (256, 512, 1024, 1024),
        depth_hidden: int = 32,
        gaussian_features: int = 256,
        gaussian_channels: Sequence[int] = (256, 512, 1024, 1024),
        gaussian_hidden: int = 128,
        sh_degree: int = 4,
        sh_mode: Literal["reference", "dc_only"] = "reference",
        pixel_center: float = 0.0,
        fuse: bool = True,
        voxel_size: Positive = 0.002,
        scale_unit: float = 0.001,
        scale_max: float = 0.3,
        chunk: AtLeastOne = 4,
        checkpointing: bool = False,
        init: Literal["published", "scratch"] = "published",
    ) -> None:
        super().__init__()
        check_options(dim=dim, heads=heads, taps=taps, first=0, depth=depth, camera_heads=camera_heads)
        self.patch_size, self.resolution, self.trusted_cameras = patch_size, resolution, trusted_cameras
        block = partial(Block, mlp_ratio=mlp_ratio)
        embedding = (block(dim, heads, layer_scale=1.0, eps=1e-6) for _ in range(embed_depth))
        patches = (
            DinoV2(dim, embedding, patch_size=patch_size, grid=native_resolution // patch_size)
            if embed == "dino"
            else Patches(dim, patch_size)
        )
        self.embedder = Embedder(dim, patches, registers=registers, patch_size=patch_size, reference=reference)
        aggregating = partial(block, dim, heads, layer_scale=layer_scale, qk_norm=True)
        self.aggregator = self.aggregator_type(
            dim, aggregating, depth=depth, rope_base=rope_base, taps=taps, checkpointing=checkpointing
        )
        trunk = (block(2 * dim, camera_heads, layer_scale=layer_scale) for _ in range(camera_depth))
        self.geometry_head = GeometryHead(
            CameraHead(2 * dim, trunk, iterations=camera_iterations, focal_epsilon=focal_epsilon),
            Dpt(dim=2 * dim, features=depth_features, channels=depth_channels, hidden=depth_hidden, outputs=2),
            taps=taps,
            chunk=2 * chunk,
            aligner=Aligner() if poses == "aligned" else None,
        )
        outputs = 9 + 3 * (sh_degree + 1) ** 2
        dpt = Dpt(
            dim=2 * dim, features=gaussian_features, channels=gaussian_channels, hidden=gaussian_hidden, outputs=outputs
        )
        direct = nn.Conv2d(3, dpt.width, 7, padding=3)
        self.gaussian_head = GaussianHead(dpt, direct, sh_degree=sh_degree, taps=taps, chunk=chunk)
        self.adapter = Adapter(
            sh_degree=sh_degree,
            sh_mode=sh_mode,
            pixel_center=pixel_center,
            fuse=fuse,
            voxel_size=voxel_size,
            scale_unit=scale_unit,
            scale_max=scale_max,
        )
        if init == "scratch":
            start_geometry(self.embedder, self.geometry_head)
            footprint = 2 * (math.tan(initial.FIELD_OF_VIEW / 2) + focal_epsilon) / resolution  # of a pixel at depth 1
            start_gaussians(self.gaussian_head, initial.PIXELS * footprint / scale_unit)


@torch.no_grad()
def start_geometry(embedder: Embedder, head: GeometryHead) -> None:
    """Cameras at the origin and depth of about 1 (see :mod:`anystyle_backbones.scratch`)."""
    for token in (embedder.camera_token, embedder.register_token):
        nn.init.normal_(token, std=0.02)  # else the layer norms of the first block see no difference between views
    assert isinstance(head.camera, CameraHead)
    step = torch.tensor([0, 0, 0, 0, 0, 0, 1, initial.FIELD_OF_VIEW, initial.FIELD_OF_VIEW]) / head.camera.iterations
    last = head.camera.pose_branch.fc2
    nn.init.normal_(last.weight, std=0.1 * initial.SMALL)
    last.bias.copy_(step)
    initial.start_small(head.depth.output[2])


@torch.no_grad()
def start_gaussians(head: GaussianHead, scale: float) -> None:
    """Gaussians of their pixel's own colour, of opacity 0.9."""
    bias = initial.start_small(head.dpt.output[2])
    bias[0] = initial.OPACITY_LOGIT
    bias[1:4] = scale + math.log(-math.expm1(-scale))  # the inverse of softplus
    bias[7] = 1.0  # the real part of xyzw
    for color, (carrier, _) in enumerate(initial.carriers(head.dpt.width)):
        initial.connect(head.direct, carrier, color, 0.0)
    initial.pass_colors_on(head.dpt, 8, head.coefficients, [1 / CONSTANT] * 3, [-0.5 / CONSTANT] * 3)
