"""The network: five parts, every option that its weights fix, and the initial values of what is not published."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch
from torch import nn

from anystyle import contracts
from anystyle.nn.attention import Block
from anystyle.ranges import AtLeastOne, Positive
from anystyle_backbones import scratch as initial
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import check_options
from anystyle_backbones.mapanything.heads import GeometryHead, PoseHead, scale_head
from anystyle_backbones.mapanything.transformer import STEM, Aggregator, Embedder
from anystyle_backbones.worldmirror.adapter import Adapter
from anystyle_backbones.worldmirror.backbone import start_gaussians
from anystyle_backbones.worldmirror.heads import GaussianHead


class MapAnything(contracts.Backbone):
    """Metric points and cameras of photographs, in one pass (MapAnything, arXiv 2509.13414), and Gaussians of them.

    The defaults are the published network, version 1.1, from images alone. It has no Gaussian head: the one here is
    WorldMirror's, with scales in footprints of pixels. Untrained it gives each pixel a Gaussian of its colour and about
    its size, of opacity 0.9, at its published point. The published weights fix every option but ``fuse``,
    ``voxel_size``, ``chunk``, ``checkpointing`` and those of the Gaussian head.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for; published pictures have a longer side of
            518, which at 4:3 is this.
        patch_size: Pixels per patch; image sides are multiples of it.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        dim: Channels of the transformers.
        embed_depth: Blocks of the embedder.
        depth: Blocks of the aggregator: even ones see all views, odd ones one.
        heads: Attention heads.
        layer_scale: Initial LayerScale of the aggregator.
        taps: The four layers that the heads read: -1 is what goes into the aggregator, the last is its last.
        depth_features: Channels of the decoder of rays and distances.
        depth_channels: Channels of its four levels.
        depth_hidden: Channels of its last hidden layer.
        pose_hidden: Channels of the pose head.
        gaussian_features: Channels of the Gaussian head's decoder.
        gaussian_channels: Channels of its four levels.
        gaussian_hidden: Channels of its last hidden layer.
        fuse: Whether pixels that share a voxel become one Gaussian.
        voxel_size: Side of a voxel, in world units, which are metres with the published weights.
        chunk: Views that the Gaussian head decodes at a time, the geometry head twice as many; it affects only memory.
        checkpointing: Whether training recomputes blocks of the aggregator to save memory.
    """

    published = "anystyle_backbones.mapanything.keys:MapAnythingCheckpoints"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        shared = {
            name: initial.SMALL_NETWORK[name] for name in initial.SMALL_NETWORK if name not in ("sh_degree", "init")
        }
        trunk = {"embed_depth": 2, "depth": 6, "taps": (-1, 2, 3, 5), "layer_scale": 0.5}
        return {**shared, **trunk, "depth_hidden": 8, "pose_hidden": 16, "gaussian_features": 16, "gaussian_hidden": 8}

    def __init__(
        self,
        *,
        resolution: int = 392,
        patch_size: int = 14,
        native_resolution: int = 518,
        dim: int = 1536,
        embed_depth: int = 24,
        depth: int = 16,
        heads: int = 24,
        layer_scale: float = 1e-5,
        taps: Sequence[int] = (-1, 7, 11, 15),
        depth_features: int = 256,
        depth_channels: Sequence[int] = (96, 192, 384, 768),
        depth_hidden: int = 128,
        pose_hidden: int = 784,
        gaussian_features: int = 256,
        gaussian_channels: Sequence[int] = (96, 192, 384, 768),
        gaussian_hidden: int = 128,
        fuse: bool = False,
        voxel_size: Positive = 0.01,
        chunk: AtLeastOne = 4,
        checkpointing: bool = False,
    ) -> None:
        super().__init__()
        check_options(dim=dim, heads=heads, taps=taps, first=STEM, depth=depth)
        self.patch_size, self.resolution = patch_size, resolution
        block = partial(Block, dim, heads, mlp_ratio=4.0, ffn="swiglu", eps=1e-6)
        embedding = (block(layer_scale=1.0) for _ in range(embed_depth))
        self.embedder = Embedder(dim, embedding, patch_size=patch_size, grid=native_resolution // patch_size)
        sharing = (block(layer_scale=layer_scale) for _ in range(depth))
        self.aggregator = Aggregator(dim, sharing, taps=taps, checkpointing=checkpointing)
        decoder = partial(Dpt, dim=dim, normed=False, rectified=False, waves=False, cropped=True)
        dense = decoder(features=depth_features, channels=depth_channels, hidden=depth_hidden, outputs=6)
        pose = PoseHead(dim, pose_hidden)
        self.geometry_head = GeometryHead(dense, pose, scale_head(dim), taps=taps, chunk=2 * chunk)
        dpt = decoder(features=gaussian_features, channels=gaussian_channels, hidden=gaussian_hidden, outputs=12)
        direct = nn.Conv2d(3, dpt.width, 7, padding=3)
        self.gaussian_head = GaussianHead(dpt, direct, taps=taps, chunk=chunk, fused=fuse)
        self.adapter = Adapter(fuse=fuse, voxel_size=voxel_size, scale_max=math.inf, footprints=True)
        start_geometry(self.geometry_head)
        start_gaussians(self.gaussian_head, initial.PIXELS)


@torch.no_grad()
def start_geometry(head: GeometryHead) -> None:
    """Rays ahead, and views turned as the world; positions and distances as they come."""
    _, bias = initial.conv(head.dense.output[2])
    bias[2] = 1.0
    head.pose.quaternion.bias[3] = 1.0  # the real part of xyzw
