"""The network: AnySplat's parts without its colours, and every option that the published weights fix."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

from torch import nn

from anystyle.contracts import StylePredictor
from anystyle.ranges import AtLeastOne, Positive
from anystyle_backbones.anysplat.backbone import AnySplat
from anystyle_backbones.anysplat.networks import Aggregator
from anystyle_backbones.dpt import Dpt
from anystyle_backbones.heads import check_taps
from anystyle_backbones.stylos.heads import GaussianHead, StylosBranch
from anystyle_backbones.stylos.transformer import Order, StemAggregator, StyleAggregator


class Stylos(AnySplat):
    """AnySplat's geometry, and colours by attention to a style image (Stylos, arXiv 2509.26455).

    The defaults are the published network of 1.42 billion parameters. The published weights fix every option but
    ``chunk`` and ``checkpointing``. Its style branch is ``branch.published=true``, and its style encoder
    ``style_encoder=stylos``.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for.
        native_resolution: Side of the square image that position embeddings are stored for; others are resampled.
        dim: Channels of the transformers.
        embed_depth: Blocks of the embedder.
        depth: Pairs of frame and global blocks.
        heads: Attention heads of the transformers and of the camera head.
        taps: The four layers that the geometry is decoded from; the last is the aggregator's last.
        camera_depth: Blocks of the camera head.
        depth_features: Channels of the depth head's decoder.
        depth_channels: Channels of its four levels.
        gaussian_features: Channels of the decoders of the Gaussians' geometry and of colours.
        gaussian_channels: Channels of their four levels.
        image_features: Whether the decoder of the Gaussians' geometry sees the images, as in the network of the demo.
        style_order: The blocks of a layer of the style aggregator: ``global`` sees all views, as released, ``frame``
            one; ``hybrid`` is a global block, then a frame block.
        style_depth: Layers of the style aggregator.
        style_taps: The four of them that colours are decoded from; the last is the last.
        voxel_size: Side of a voxel, in world units.
        chunk: Views that the Gaussian head decodes at a time, the depth head twice as many; it affects only memory.
        checkpointing: Whether training recomputes blocks of the style aggregator to save memory.
    """

    published = "anystyle_backbones.stylos.keys:StylosCheckpoints"
    aggregator_type: ClassVar[type[Aggregator]] = StemAggregator

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        sizes = {"resolution": 56, "native_resolution": 56, "dim": 32, "heads": 2}
        depths = {"embed_depth": 1, "depth": 5, "taps": (1, 2, 3, 4), "camera_depth": 1, "style_depth": 4}
        decoders = {"depth_features": 16, "depth_channels": (8,) * 4, "gaussian_channels": (8,) * 4}
        return {**sizes, **depths, **decoders, "gaussian_features": 16, "style_taps": (0, 1, 2, 3), "voxel_size": 0.02}

    def __init__(
        self,
        *,
        resolution: int = 448,
        native_resolution: int = 518,
        dim: int = 1024,
        embed_depth: int = 24,
        depth: int = 24,
        heads: int = 16,
        taps: Sequence[int] = (4, 11, 17, 23),
        camera_depth: int = 4,
        depth_features: int = 256,
        depth_channels: Sequence[int] = (256, 512, 1024, 1024),
        gaussian_features: int = 256,
        gaussian_channels: Sequence[int] = (256, 512, 1024, 1024),
        image_features: bool = False,
        style_order: Order = "global",
        style_depth: int = 12,
        style_taps: Sequence[int] = (2, 5, 8, 11),
        voxel_size: Positive = 0.002,
        chunk: AtLeastOne = 4,
        checkpointing: bool = False,
    ) -> None:
        check_taps("style_taps", style_taps, 0, style_depth)
        super().__init__(
            resolution=resolution,
            native_resolution=native_resolution,
            dim=dim,
            embed_depth=embed_depth,
            depth=depth,
            heads=heads,
            taps=taps,
            camera_depth=camera_depth,
            camera_heads=heads,
            depth_features=depth_features,
            depth_channels=depth_channels,
            gaussian_features=8,  # of a head that is replaced below
            gaussian_channels=(4, 4, 4, 4),
            gaussian_hidden=1,
            sh_degree=0,
            sh_mode="dc_only",
            voxel_size=voxel_size,
            chunk=chunk,
        )
        decoder = partial(Dpt, features=gaussian_features, channels=gaussian_channels, hidden=128)
        dpt = decoder(dim=2 * dim, outputs=9)
        direct = nn.Sequential(
            nn.Conv2d(3, dpt.width, 7, padding=3), nn.ReLU(inplace=True), nn.Conv2d(dpt.width, dpt.width, 3, padding=1)
        )
        style_aggregator = StyleAggregator(
            dim, heads, depth=style_depth, order=style_order, taps=style_taps, checkpointing=checkpointing
        )
        style_dpt = decoder(dim=2 * dim if style_order == "hybrid" else dim, outputs=4)
        features = direct if image_features else None
        self.gaussian_head = GaussianHead(dpt, features, style_aggregator, style_dpt, taps=taps, chunk=chunk)

    def make_branch(self) -> StylePredictor:
        assert isinstance(self.gaussian_head, GaussianHead)
        return StylosBranch(self.gaussian_head)
