"""The network: five parts, and every option that its weights fix."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from anystyle import contracts
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne, Positive, Range
from anystyle_backbones.anysplat.adapter import Adapter
from anystyle_backbones.dpt import Dpt, DptTrunkOptions
from anystyle_backbones.styl3r.heads import ColorHead, GaussianHead, GeometryHead, PixelDecoder, Styl3rBranch
from anystyle_backbones.styl3r.transformer import Aggregator, Embedder, ImageEncoder, TokenStylizer


class Styl3r(contracts.Backbone):
    """Points, one Gaussian per pixel and styled colours of photographs, in one pass (Styl3R, arXiv 2505.21060).

    The defaults are the published network of 1.05 billion parameters, which three files of weights share. They fix
    every option but ``field_of_view`` and ``chunk``. It needs two photographs or more, and reads their intrinsics.
    Gaussians of all pixels are kept; the unit of the world is the distance of the first and the last camera.

    Args:
        resolution: Shorter side, in pixels, that the weights were made for.
        patch_size: Pixels per patch; image sides are multiples of it.
        field_of_view: Along the shorter side of photographs whose cameras are not known, in degrees.
        dim: Channels of the encoders.
        depth: Their blocks.
        heads: Their attention heads.
        decoder_dim: Channels of the decoders.
        decoder_depth: Their blocks; heads read what goes in, and half, three quarters and the end of them.
        decoder_heads: Their attention heads.
        mlp_ratio: Width of all feed-forward layers, in their channels.
        rope_base: Base of the frequencies of the rotary position embedding.
        features: Channels of the heads' decoders.
        channels: Channels of their four levels.
        hidden: Channels of the last hidden layer of points.
        sh_degree: Degree of the spherical harmonics.
        scale_unit: World units of a Gaussian's scale a unit of softplus.
        scale_max: Largest scale, in world units.
        chunk: Views that heads decode at a time; it affects only memory.
    """

    published = "anystyle_backbones.styl3r.keys:Styl3rCheckpoints"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        trunk: dict[str, object] = {
            "resolution": 64,
            "dim": 32,
            "depth": 2,
            "heads": 2,
            "decoder_dim": 24,
            "decoder_depth": 4,
        }
        heads: dict[str, object] = {
            "decoder_heads": 2,
            "features": 16,
            "channels": (8, 8, 8, 8),
            "hidden": 8,
            "sh_degree": 1,
        }
        return trunk | heads | {"scale_unit": 0.01}

    def __init__(
        self,
        *,
        resolution: int = 256,
        patch_size: int = 16,
        field_of_view: Annotated[float, Range(gt=0, lt=180)] = 60.0,
        dim: int = 1024,
        depth: int = 24,
        heads: int = 16,
        decoder_dim: int = 768,
        decoder_depth: Annotated[int, Range(ge=3)] = 12,
        decoder_heads: int = 12,
        mlp_ratio: float = 4.0,
        rope_base: float = 100.0,
        features: int = 256,
        channels: Sequence[int] = (96, 192, 384, 768),
        hidden: int = 128,
        sh_degree: int = 0,
        scale_unit: Positive = 0.001,
        scale_max: Positive = 0.3,
        chunk: AtLeastOne = 4,
    ) -> None:
        super().__init__()
        for name, width, count in (("heads", dim, heads), ("decoder_heads", decoder_dim, decoder_heads)):
            if width % (4 * count):
                raise UserError(f"{name} is {count}, of {width} channels; those of a head must be a multiple of 4")
        self.patch_size, self.resolution = patch_size, resolution
        common = {"mlp_ratio": mlp_ratio, "rope_base": rope_base}
        encoder = partial(ImageEncoder, dim, patch_size=patch_size, depth=depth, heads=heads, **common)
        decoder = {"depth": decoder_depth, "heads": decoder_heads, **common}
        levels: DptTrunkOptions = {
            "dim": (dim, *(decoder_dim,) * 3),
            "channels": channels,
            "normed": False,
            "rectified": False,
            "waves": False,
            "cropped": True,
        }
        pixels = partial(PixelDecoder, features=features, **levels)
        self.embedder = Embedder(encoder(), field_of_view=field_of_view)
        self.aggregator = Aggregator(dim, decoder_dim, **decoder)
        points = (Dpt(features=features, hidden=hidden, outputs=3, **levels) for _ in range(2))
        self.geometry_head = GeometryHead(*points, chunk=chunk)
        color = pixels(outputs=3 * (sh_degree + 1) ** 2, reads_image=False)
        self.gaussian_head = GaussianHead(
            *(pixels(outputs=8, reads_image=True) for _ in range(2)),
            style_encoder=encoder(),
            stylizer=TokenStylizer(dim, decoder_dim, **decoder),
            color=ColorHead(color, sh_degree=sh_degree, chunk=chunk),
            chunk=chunk,
        )
        self.adapter = Adapter(
            sh_degree=sh_degree,
            sh_mode="dc_only",
            pixel_center=0.5,
            fuse=False,
            voxel_size=1.0,
            scale_unit=scale_unit,
            scale_max=scale_max,
        )

    def make_branch(self) -> Styl3rBranch:
        assert isinstance(self.gaussian_head, GaussianHead)
        return Styl3rBranch(self.gaussian_head)
