"""The network: five parts, every option that its weights fix, and initial values for training without weights."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from anystyle import contracts
from anystyle.nn.attention import Block
from anystyle.ranges import AtLeastOne, Positive
from anystyle_backbones import scratch as initial
from anystyle_backbones.anysplat.backbone import start_geometry
from anystyle_backbones.anysplat.heads import CameraHead
from anystyle_backbones.anysplat.transformer import Aggregator, DinoV2
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import check_options
from anystyle_backbones.worldmirror.adapter import Adapter
from anystyle_backbones.worldmirror.embedder import Embedder
from anystyle_backbones.worldmirror.heads import GaussianHead, GeometryHead


class WorldMirror(contracts.Backbone):
    """Cameras, depth and one Gaussian per pixel of photographs, in one pass (WorldMirror, arXiv 2510.10726).

    The defaults are the published network, version 1. The published weights fix every option but ``known``, ``fuse``,
    ``voxel_size``, ``chunk`` and ``checkpointing``.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for.
        patch_size: Pixels per patch; image sides are multiples of it.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        dim: Channels of the transformers.
        embed_depth: Blocks of the embedder.
        depth: Pairs of frame and global blocks.
        heads: Attention heads of the transformers.
        known: What is read of cameras where views have them: ``nothing``, ``lenses`` (intrinsics), or ``cameras``,
            lenses and poses. Cameras are predicted all the same, in a frame of their own.
        taps: The four layers that the heads read; the last is the aggregator's last.
        camera_depth: Blocks of the camera head.
        camera_heads: Its attention heads.
        depth_features: Channels of the depth head's decoder.
        depth_channels: Channels of its four levels.
        depth_hidden: Channels of the last hidden layers that predict a depth.
        gaussian_features: Channels of the Gaussian head's decoder.
        gaussian_channels: Channels of its four levels.
        gaussian_hidden: Channels of its last hidden layer.
        fuse: Whether pixels that share a voxel become one Gaussian.
        voxel_size: Side of a voxel, in world units.
        scale_max: Largest scale of a Gaussian, in world units.
        chunk: Views that the Gaussian head decodes at a time, the depth head twice as many; it affects only memory.
        checkpointing: Whether training recomputes blocks of the aggregator to save memory.
        init: ``published``: initial values as DINOv2's and VGGT's; ``scratch``: values from which photographs are
            reproduced on a plane at depth 1, for training without pretrained weights (see
            :mod:`anystyle_backbones.scratch`). The computation is the same.
    """

    published = "anystyle_backbones.worldmirror.keys:WorldMirrorCheckpoints"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        shared = {name: value for name, value in initial.SMALL_NETWORK.items() if name != "sh_degree"}
        depths = {"embed_depth": 1, "depth": 5, "taps": (1, 2, 3, 4), "camera_depth": 1, "camera_heads": 2}
        widths = {"depth_hidden": 8, "gaussian_features": 16, "gaussian_hidden": 8}
        return {**shared, **depths, **widths, "voxel_size": 0.02}

    def __init__(
        self,
        *,
        resolution: int = 518,
        patch_size: int = 14,
        native_resolution: int = 518,
        dim: int = 1024,
        embed_depth: int = 24,
        depth: int = 24,
        heads: int = 16,
        known: Literal["nothing", "lenses", "cameras"] = "nothing",
        taps: Sequence[int] = (4, 11, 17, 23),
        camera_depth: int = 4,
        camera_heads: int = 16,
        depth_features: int = 256,
        depth_channels: Sequence[int] = (256, 512, 1024, 1024),
        depth_hidden: int = 32,
        gaussian_features: int = 256,
        gaussian_channels: Sequence[int] = (256, 512, 1024, 1024),
        gaussian_hidden: int = 256,
        fuse: bool = True,
        voxel_size: Positive = 0.002,
        scale_max: float = 0.3,
        chunk: AtLeastOne = 4,
        checkpointing: bool = False,
        init: Literal["published", "scratch"] = "published",
    ) -> None:
        super().__init__()
        check_options(dim=dim, heads=heads, taps=taps, first=0, depth=depth, camera_heads=camera_heads)
        self.patch_size, self.resolution = patch_size, resolution
        block = partial(Block, mlp_ratio=4.0, layer_scale=0.01)
        embedding = (block(dim, heads, layer_scale=1.0, eps=1e-6) for _ in range(embed_depth))
        patches = DinoV2(dim, embedding, patch_size=patch_size, grid=native_resolution // patch_size)
        self.embedder = Embedder(dim, patches, registers=4, patch_size=patch_size, known=known)
        aggregating = partial(block, dim, heads, qk_norm=True)
        self.aggregator = Aggregator(
            dim, aggregating, depth=depth, rope_base=100.0, taps=taps, checkpointing=checkpointing
        )
        trunk = (block(2 * dim, camera_heads) for _ in range(camera_depth))
        depth_decoder = partial(Dpt, dim=2 * dim, hidden=depth_hidden, outputs=2)
        self.geometry_head = GeometryHead(
            CameraHead(2 * dim, trunk, iterations=4, focal_epsilon=0.0),
            depth_decoder(features=depth_features, channels=depth_channels),
            depth_decoder(features=gaussian_features, channels=gaussian_channels),
            taps=taps,
            chunk=2 * chunk,
        )
        dpt = Dpt(
            dim=2 * dim,
            features=gaussian_features,
            channels=gaussian_channels,
            hidden=gaussian_hidden,
            outputs=12,
            bias=False,
        )
        direct = nn.Conv2d(3, dpt.width, 7, padding=3)
        self.gaussian_head = GaussianHead(dpt, direct, taps=taps, chunk=chunk, fused=fuse)
        self.adapter = Adapter(fuse=fuse, voxel_size=voxel_size, scale_max=scale_max)
        if init == "scratch":
            start_geometry(self.embedder, self.geometry_head)
            initial.start_small(self.geometry_head.placing.output[2])
            footprint = 2 * math.tan(initial.FIELD_OF_VIEW / 2) / resolution  # of a pixel at depth 1
            start_gaussians(self.gaussian_head, initial.PIXELS * footprint)


@torch.no_grad()
def start_gaussians(head: GaussianHead, scale: float) -> None:
    """Gaussians of their pixel's own colour, of opacity 0.9 (see :mod:`anystyle_backbones.scratch`)."""
    bias = initial.start_small(head.dpt.output[2])
    bias[0] = 1.0  # the real part of wxyz
    bias[4:7] = math.log(scale)
    bias[[7, 11]] = initial.OPACITY_LOGIT
