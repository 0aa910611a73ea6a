"""What is read off the tokens: points with the cameras that see them, raw Gaussians, and the styled colours."""

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar, Unpack

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.contracts import StylePredictor, style_tokens
from anystyle.types import Attributes, Features, Geometry, Inject, Scene, Site, StyleEmbedding, untouched
from anystyle_backbones.dpt import Dpt, DptTrunk, DptTrunkOptions, by_views, resized
from anystyle_backbones.styl3r.pointmaps import cameras_of, points_of
from anystyle_backbones.styl3r.transformer import ImageEncoder, TokenStylizer, symmetric

Decoding = TypeVar("Decoding", bound=DptTrunk)


def first_and_others(
    first: Decoding, others: Decoding, decode: Callable[[Decoding, slice], Tensor], shape: torch.Size, chunk: int
) -> Float[Tensor, "B V *rest"]:
    """What ``decode`` gives by one decoder for the first view and by another for the rest, some views at a time.

    ``shape`` begins with the numbers of scenes and views; at most ``chunk`` views of all scenes are decoded together.
    """
    batch, views = shape[:2]
    results = [decode(first, slice(0, 1))]
    if views > 1:
        behind = lambda chosen: decode(others, slice(chosen.start + 1, chosen.stop + 1))  # noqa: E731
        results.append(by_views(behind, views - 1, max(1, chunk // batch)))
    return torch.cat(results, dim=1)


def levels_of(features: Features, views: slice, dtype: torch.dtype) -> list[Float[Tensor, "M p C"]]:
    """Patch tokens of some views of all taps, the earliest first.

    They are contiguous, for products of others are rounded in another way where weights learn, as a branch's do.
    """
    return [tokens.patches[:, views].to(dtype).flatten(0, 1).contiguous() for tokens in features.values()]


class GeometryHead(contracts.GeometryHead):
    """World points of the pixels, by decoders of the first view and of all others, and cameras that see them.

    The world is the frame of the first camera. The network predicts no cameras, and this head is not shown the given
    ones: :func:`~anystyle_backbones.styl3r.pointmaps.cameras_of` fits them to the points. Depth is the points' z in
    their view's camera, and may be negative. Where a photograph is higher than wide, points are in the order of its
    pixels; the published code has them column by column there, and pairs them with the attributes of other pixels.

    Args:
        first: Decodes the first view.
        others: Decodes all others.
        chunk: Views decoded at a time, which changes memory only.
    """

    def __init__(self, first: Dpt, others: Dpt, *, chunk: int) -> None:
        super().__init__()
        self.first, self.others, self.chunk = first, others, chunk

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry; the confidence is 1 everywhere."""
        with torch.autocast(images.device.type, enabled=False):
            points = points_of(self.raw(features, images).float())
            cameras = cameras_of(points.detach())
            pose = cameras.camera_from_world[:, :, None, None]
            depth = (pose[..., 2, :3] * points).sum(-1) + pose[..., 2, 3]
        return Geometry(cameras, depth, torch.ones_like(depth), points)

    def raw(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V H W 3"]:
        """Points ahead of their activation; of the images only the size is read."""
        size = images.shape[-2], images.shape[-1]

        def decode(dpt: Dpt, chosen: slice) -> Float[Tensor, "B v H W 3"]:
            levels = levels_of(features, chosen, dpt.dtype)
            return dpt.predict_(dpt.decode(levels, features[0].grid, size)).unflatten(0, (len(images), -1))

        return first_and_others(self.first, self.others, decode, images.shape, self.chunk)


class PixelDecoder(DptTrunk):
    """A decoder whose map of all features is brought to the image's size, joined by features of the image if asked.

    Args:
        features: Channels of the decoder.
        outputs: Channels of the result.
        reads_image: Whether features of the image, of a convolution, are added.
        options: Those of :class:`~anystyle_backbones.dpt.DptTrunk`.
    """

    def __init__(self, *, features: int, outputs: int, reads_image: bool, **options: Unpack[DptTrunkOptions]) -> None:
        super().__init__(features=features, **options)
        self.direct = nn.Conv2d(3, features, 7, padding=3) if reads_image else None
        hidden = nn.Conv2d(features, features, 3, padding=1, bias=False)
        self.output = nn.Sequential(hidden, nn.ReLU(inplace=True), nn.Conv2d(features, outputs, 1))

    def predict(
        self, features: Features, images: Float[Tensor, "B V 3 H W"], views: slice
    ) -> Float[Tensor, "B v H W F"]:
        """The result for some views of images in [-1, 1]."""
        size = images.shape[-2], images.shape[-1]
        maps = self.levels(levels_of(features, views, self.dtype), features[0].grid, size[1] / size[0])
        x = resized(self.fusions(maps), size)
        if self.direct is not None:
            x = x + F.relu(self.direct(images[:, views].flatten(0, 1).to(self.dtype)))
        return self.output(x).movedim(1, -1).unflatten(0, (len(images), -1))


class ColorHead(nn.Module):
    """Colours of all views by one decoder, which does not see their pixels.

    Args:
        dpt: Its outputs are colour by colour, the coefficients of each together.
        sh_degree: Degree of the spherical harmonics.
        chunk: Views decoded at a time, which changes memory only.
    """

    def __init__(self, dpt: PixelDecoder, *, sh_degree: int, chunk: int) -> None:
        super().__init__()
        self.dpt, self.sh_degree, self.chunk = dpt, sh_degree, chunk

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V H W 3 K"]:
        """Harmonics ahead of their damping, from a stylizer's features; of the images only the size is read."""
        batch, views = images.shape[:2]
        decode = partial(self.dpt.predict, features, images)
        return by_views(decode, views, max(1, self.chunk // batch)).unflatten(-1, (3, -1))


class GaussianHead(contracts.GaussianHead):
    """Opacity, scale and rotation by decoders of the first view and of all others, and colours by the token stylizer.

    There is no network without style: unstyled colours are those in the style of the first photograph, which the
    stylizer's own encoder reads in [-1, 1].

    Args:
        first: Decodes the first view: opacity (1), scale (3), quaternion xyzw (4).
        others: Decodes all others.
        style_encoder: The stylizer's encoder.
        stylizer: Gives features of the encoder's tokens in a style.
        color: Reads colours off them.
        chunk: Views decoded at a time, which changes memory only.
    """

    def __init__(
        self,
        first: PixelDecoder,
        others: PixelDecoder,
        *,
        style_encoder: ImageEncoder,
        stylizer: TokenStylizer,
        color: ColorHead,
        chunk: int,
    ) -> None:
        super().__init__()
        self.first, self.others, self.chunk = first, others, chunk
        self.style_encoder, self.stylizer, self.color = style_encoder, stylizer, color

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/stylizer/<block>``, the stylizer's stream of tokens ahead of every block."""
        return self.stylizer.sites

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        color = self.color(self.stylizer(features[0], self.style_encoder(symmetric(images[:, :1])), inject), images)
        return replace(self.without_colors(features, images), color=color)

    def without_colors(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Attributes:
        pictures = symmetric(images)

        def decode(dpt: PixelDecoder, chosen: slice) -> Float[Tensor, "B v H W 8"]:
            return dpt.predict(features, pictures, chosen)

        raw = first_and_others(self.first, self.others, decode, pictures.shape, self.chunk)
        color = raw.new_zeros(*raw.shape[:-1], 3, (self.color.sh_degree + 1) ** 2)
        return Attributes(opacity=raw[..., 0], scale=raw[..., 1:4], rotation=raw[..., 4:], color=color)


class Styl3rBranch(StylePredictor):
    """The published branch: copies of the token stylizer's decoder and of the colours' decoder.

    Style touches colours alone, and its tokens may have any grid.
    """

    reads_tokens = True
    reads_colors = False

    def __init__(self, head: GaussianHead) -> None:
        super().__init__()
        self.styled, self.sh_degree = ("color",), head.color.sh_degree
        self.aggregator = copy.deepcopy(head.stylizer).requires_grad_()
        self.gaussian_head = copy.deepcopy(head.color).requires_grad_()
        self.injectors = nn.ModuleDict()

    def forward(self, scene: Scene, embedding: StyleEmbedding) -> Attributes:
        assert isinstance(self.aggregator, TokenStylizer) and isinstance(self.gaussian_head, ColorHead)
        features = self.aggregator(scene.features[0], style_tokens(embedding))
        color = self.gaussian_head(features, scene.views.images)
        attributes = scene.attributes
        return Attributes(attributes.opacity, attributes.scale, attributes.rotation, color)
