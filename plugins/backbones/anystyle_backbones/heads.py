"""Gaussian and geometry heads on a DPT decoder, and cameras of pose encodings; a backbone adds what is its own."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isqrt
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.errors import UserError
from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_xyzw
from anystyle.nn.tokens import constant
from anystyle.types import Attributes, Cameras, Features, Geometry, Inject, Site, Tokens, untouched
from anystyle_backbones.aligner import Aligner
from anystyle_backbones.dpt import Dpt, by_views


class DptGaussians(contracts.GaussianHead):
    """One raw Gaussian per pixel: a DPT whose decoded map is joined by features of the image itself.

    Args:
        dpt: The decoder; the channels of its result are those that :meth:`attributes` reads.
        direct: Computes these features, for :meth:`image_features`.
        sh_degree: Degree of the spherical harmonics.
        taps: The layers that the decoder reads, four, in rising order.
        chunk: Views decoded at a time, which changes memory only.
    """

    def __init__(self, dpt: Dpt, direct: nn.Module, *, sh_degree: int, taps: Sequence[int], chunk: int) -> None:
        super().__init__()
        self.dpt, self.direct = dpt, direct
        self.coefficients = (sh_degree + 1) ** 2
        self.taps, self.chunk = tuple(taps), chunk

    @abstractmethod
    def image_features(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        """Features of every pixel of sRGB images in [0, 1], row by row."""

    @abstractmethod
    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        """Name the channels of the decoder's result."""

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/tokens/0..3``, normalised patch tokens of the levels; ``head/direct``, features of pixels."""
        tokens = tuple(Site(f"head/tokens/{level}", self.dpt.dim) for level in range(len(self.taps)))
        return (*tokens, Site("head/direct", self.dpt.width))

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        size = images.shape[-2], images.shape[-1]

        def direct(views: slice) -> Float[Tensor, "M E H W"]:
            chosen = images[:, views].to(self.dpt.dtype)
            found = self.image_features(chosen.flatten(0, 1)).unflatten(0, chosen.shape[:2])
            found = inject("head/direct", Tokens(found, grid=size)).data
            return found.flatten(0, 1).unflatten(1, size).movedim(-1, 1)

        levels = [features[layer] for layer in self.taps]
        return self.attributes(decoded_maps(self.dpt, levels, size, chunk=self.chunk, direct=direct, inject=inject))


def decoded_maps(
    dpt: Dpt,
    levels: Sequence[Tokens],
    size: tuple[int, int],
    *,
    chunk: int,
    direct: Callable[[slice], Float[Tensor, "M E H W"]] | None = None,
    inject: Inject = untouched,
) -> Float[Tensor, "B V H W F"]:
    """A decoder's result from tokens of its levels, the earliest first, at ``size``; ``chunk`` views at a time.

    ``direct`` computes what is added to the decoded maps of some views; ``inject`` is called with the normalised tokens
    of each level, at ``head/tokens/0..3``.
    """
    batch, views = levels[0].data.shape[:2]

    def decode(chosen: slice) -> Float[Tensor, "B v H W F"]:
        tokens = [replace(one, data=dpt.norm(one.patches[:, chosen].to(dpt.dtype)), special=0) for one in levels]
        tokens = [inject(f"head/tokens/{level}", one) for level, one in enumerate(tokens)]
        decoded = dpt.decode([one.data.flatten(0, 1) for one in tokens], levels[-1].grid, size)
        decoded = decoded if direct is None else decoded.add_(direct(chosen))
        return dpt.predict_(decoded).unflatten(0, (batch, -1))

    return by_views(decode, views, max(1, chunk // batch))


class CameraRegressor(nn.Module, ABC):
    """Reads cameras off tokens."""

    @abstractmethod
    def cameras(self, tokens: Float[Tensor, "B V C"], size: tuple[int, int]) -> Cameras:
        """Cameras of images of a size, in fp32, from one token per view."""


class GeometryHead(contracts.GeometryHead):
    """Cameras from the last tap's leading token, and a DPT for depth; in the weights' precision throughout.

    Args:
        camera: Reads cameras off tokens.
        depth: Predicts the logarithm of depth, and of confidence less one.
        taps: The layers that the depth head reads, four, in rising order.
        chunk: Views decoded at a time, which changes memory only.
        aligner: Computes poses from matches instead of the regressed ones, whose focal lengths are kept.
    """

    def __init__(
        self, camera: CameraRegressor, depth: Dpt, *, taps: Sequence[int], chunk: int, aligner: Aligner | None = None
    ) -> None:
        super().__init__()
        self.camera, self.depth, self.aligner = camera, depth, aligner
        self.taps, self.chunk = tuple(taps), chunk

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        """Predict geometry; depth is the distance along z."""
        last = features[self.taps[-1]]
        with torch.autocast(images.device.type, enabled=False):
            # Cameras too: under autocast a product of matrices would leave poses with three digits.
            cameras = self.camera.cameras(last.data[:, :, 0].to(self.depth.dtype), (images.shape[-2], images.shape[-1]))
            levels, size = [features[layer] for layer in self.taps], (images.shape[-2], images.shape[-1])
            raw = decoded_maps(self.depth, levels, size, chunk=self.chunk).float()
        depth, confidence = raw.exp().unbind(-1)
        geometry = Geometry(cameras=cameras, depth=depth, confidence=1 + confidence)
        return geometry if self.aligner is None else self.aligner.aligned(geometry, images, last.reference)


def check_options(*, dim: int, heads: int, taps: Sequence[int], first: int, depth: int, camera_heads: int = 1) -> None:
    """Refuse options of a backbone that contradict each other; heads read layers ``first`` to ``depth - 1``."""
    if dim % (4 * heads):
        raise UserError(f"dim {dim} with {heads} heads; the channels of a head must be a multiple of 4")
    check_taps("taps", taps, first, depth)
    if 2 * dim % camera_heads:
        raise UserError(f"camera_heads is {camera_heads}, which does not divide the camera head's {2 * dim} channels")


def check_taps(name: str, taps: Sequence[int], first: int, depth: int) -> None:
    """Refuse what are not four layers from ``first`` to ``depth - 1``, this one the last."""
    if len(taps) != 4 or list(taps) != sorted(set(taps)) or taps[0] < first or taps[-1] != depth - 1:
        wanted = f"four layers from {first} on in rising order, of which the last is depth - 1 = {depth - 1}"
        raise UserError(f"{name} are {list(taps)}; give {wanted}")


def positions(stored: Float[Tensor, "1 L C"], grid: tuple[int, int], **resampling: Any) -> Float[Tensor, "1 M C"]:
    """Position embeddings of a class token and a grid; where the grid is not the stored one, it is resampled."""
    side = isqrt(stored.shape[1] - 1)
    if grid == (side, side):
        return stored
    patches = stored[:, 1:].float().mT.unflatten(2, (side, side))
    resampled = F.interpolate(patches, mode="bicubic", **resampling)
    return torch.cat([stored[:, :1].float(), resampled.flatten(2).mT], dim=1)


def rotation_of(encoding: Float[Tensor, "B V 9"]) -> Float[Tensor, "B V 3 3"]:
    """The rotation of pose encodings: translation (3), quaternion xyzw (4), tangents or angles of the view (2)."""
    return matrix_from_wxyz(wxyz_from_xyzw(encoding[..., 3:7]))


def centred_cameras(
    rotation: Float[Tensor, "B V 3 3"],
    origin: Float[Tensor, "B V 3"],
    tangent: Float[Tensor, "B V 2"],
    size: tuple[int, int],
) -> Cameras:
    """Cameras with the principal point in the middle of images of ``size``, height and width.

    ``rotation`` is world from camera; ``tangent`` that of half the vertical and half the horizontal field of view.
    """
    height, width = size
    kept = constant((0.0, 0.0, 0.0, 1.0, width / 2, height / 2), origin.device, origin.dtype)
    last, (zero, *_, one, middle, centre) = kept[:4], (each.expand(tangent.shape[:-1]) for each in kept)
    focal_y, focal_x = centre / tangent[..., 0], middle / tangent[..., 1]
    # Joined, not filled in: products of matrices round by their layout, and exchanged views are to give the same.
    pose = torch.cat([rotation, origin[..., None]], dim=-1)
    pose = torch.cat([pose, last.expand(*origin.shape[:-1], 1, 4)], dim=-2)
    entries = [focal_x, zero, middle, zero, focal_y, centre, zero, zero, one]
    return Cameras(pose, torch.stack(entries, dim=-1).unflatten(-1, (3, 3)), size)
