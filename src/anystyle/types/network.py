"""Tokens, styles, sites and raw predictions: values inside a network, and which weights it has."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types.shapes import Given, Value
from anystyle.types.views import Cameras


@dataclass(frozen=True)
class Tokens(Value):
    """Tokens of views.

    Args:
        data: The special tokens of a view first, then its patches in row-major order.
        grid: Rows and columns of patches.
        special: How many special tokens (camera, registers) lead.
        reference: The view that the others are seen from, where a backbone chooses it; ``None`` means the first.
    """

    data: Float[Tensor, "B V P C"]
    grid: tuple[int, int]
    special: int = 0
    reference: Int[Tensor, " B"] | None = None

    @property
    def patches(self) -> Float[Tensor, "B V p C"]:
        """The tokens that stand for patches."""
        return self.data[:, :, self.special :]

    def contiguous(self) -> "Tokens":
        """These tokens in row-major memory; the same object if they are already."""
        return self if self.data.is_contiguous() else replace(self, data=self.data.contiguous())

    def with_data(self, data: Float[Tensor, "B V P C"]) -> "Tokens":
        """These tokens with other values."""
        return replace(self, data=data)

    def with_patches(self, patches: Float[Tensor, "B V p C"]) -> "Tokens":
        """These tokens with other patches and the special tokens untouched."""
        data = torch.cat([self.data[:, :, : self.special], patches], dim=2) if self.special else patches
        return replace(self, data=data)


Features = Mapping[int, Tokens]
"""The tokens that heads read, by the layer they were tapped at."""


def contiguous(features: Features) -> Features:
    """Features in row-major memory."""
    return {layer: tokens.contiguous() for layer, tokens in features.items()}


@dataclass(frozen=True)
class StyleEmbedding(Given):
    """A style as the network reads it.

    Args:
        vector: The embedding, as the style encoder gives it, or a mixture of two.
        direction: The normalised difference from the neutral prompt's embedding; what the CLIP losses compare with.
        scale: Size of strokes, relative to the model's own.
        tokens: The style image as tokens, where the style encoder gives them; one view, whose grid is the image's.
    """

    vector: Float[Tensor, "B D"]
    direction: Float[Tensor, "B D"]
    scale: float = 1.0
    tokens: Tokens | None = None

    def toward(self, other: "StyleEmbedding", amount: "float | Float[Tensor, ' B']") -> "StyleEmbedding":
        """The point at ``amount`` in [0, 1] of the straight way to ``other``; not normalised again, as published.

        Example:
            >>> red = StyleEmbedding(torch.tensor([[1.0, 0.0]]), torch.tensor([[1.0, 0.0]]))
            >>> blue = StyleEmbedding(torch.tensor([[0.0, 1.0]]), torch.tensor([[0.0, 1.0]]))
            >>> red.toward(blue, 0.25).vector
            tensor([[0.7500, 0.2500]])
        """
        if other.vector.shape[1] != self.vector.shape[1]:
            sizes = f"{self.vector.shape[1]} and {other.vector.shape[1]}"
            raise UserError(f"embeddings of {sizes} dimensions cannot be mixed; make both with one stylizer's `embed`")
        weight = torch.as_tensor(amount, dtype=self.vector.dtype, device=self.vector.device).reshape(-1, 1)
        tokens = None
        if self.tokens is not None and other.tokens is not None:
            tokens = self.tokens.with_data(torch.lerp(self.tokens.data, other.tokens.data, weight[..., None, None]))
        return StyleEmbedding(
            vector=torch.lerp(self.vector, other.vector, weight),
            direction=torch.lerp(self.direction, other.direction, weight),
            scale=self.scale,
            tokens=tokens,
        )


@dataclass(frozen=True)
class Site:
    """A point of a network where style may enter.

    Args:
        name: Part and position, such as ``aggregator/4`` or ``head/tokens/0``; the first word is the part.
        dim: Channels of the tokens there.
        tapped: Whether it is the first layer or one that a head reads; the published method injects at these.
    """

    name: str
    dim: int
    tapped: bool = True


def matching_sites(sites: Sequence[Site], patterns: Sequence[str], *, every_layer: bool = True) -> tuple[Site, ...]:
    """The sites whose names match any of some shell-style patterns, in the order of the computation.

    Args:
        sites: All that there are.
        patterns: Such as ``head/*``.
        every_layer: Whether layers that no head reads are taken too.
    """
    offered = [site for site in sites if site.tapped or every_layer]
    for pattern in patterns:
        if not any(fnmatchcase(site.name, pattern) for site in offered):
            names = ", ".join(site.name for site in offered) or "none"
            raise UserError(f"no site is called '{pattern}' here; there are: {names}")
    return tuple(site for site in offered if any(fnmatchcase(site.name, pattern) for pattern in patterns))


Inject = Callable[[str, Tokens], Tokens]
"""Called with a site's name and the tokens there; returns the tokens to go on with."""


def untouched(site: str, tokens: Tokens) -> Tokens:
    """The :data:`Inject` of a network without style: every site passes its tokens on."""
    return tokens


@dataclass(frozen=True)
class Geometry(Value):
    """What a backbone predicts of the shape of a scene.

    Args:
        cameras: The predicted cameras, for the input views' size.
        depth: As the backbone defines it and its adapter reads it, in the scene's units.
        confidence: Confidence of the depth, at least 0; larger is surer.
        pointmap: World points of the pixels, where a backbone predicts them beside or in place of depth; they need not
            lie on the rays of the cameras.
    """

    cameras: Cameras
    depth: Float[Tensor, "B V H W"]
    confidence: Float[Tensor, "B V H W"]
    pointmap: Float[Tensor, "B V H W 3"] | None = None

    def points(self, pixel_center: float = 0.5) -> Float[Tensor, "B V H W 3"]:
        """World points of every pixel: ``pointmap``, or else ``depth`` as distance along z.

        ``pixel_center`` is where in the pixel the ray passes; the published AnySplat weights were trained with 0.
        """
        if self.pointmap is not None:
            return self.pointmap
        intrinsics, pose = self.cameras.intrinsics, self.cameras.world_from_camera
        like = {"device": self.depth.device, "dtype": self.depth.dtype}
        v, u = (torch.arange(pixel_center, side, **like) for side in self.depth.shape[-2:])
        x = (u - intrinsics[..., 0, 2, None]) / intrinsics[..., 0, 0, None]  # B V W
        y = (v - intrinsics[..., 1, 2, None]) / intrinsics[..., 1, 1, None]  # B V H
        # Axis by axis, for a matrix product would be rounded under autocast.
        right, down, forward, origin = pose[..., :3, :, None, None].unbind(3)  # each B V 3 1 1
        horizontal, vertical = x[..., None, :] * self.depth, y[..., :, None] * self.depth
        world = torch.addcmul(right * horizontal[:, :, None], down, vertical[:, :, None])
        world = torch.addcmul(world, forward, self.depth[:, :, None]) + origin  # B V 3 H W
        return world.movedim(2, -1).contiguous()

    def seen_from(self, cameras: Cameras) -> "Geometry":
        """The same depth in other cameras of the images: each point stays at its pixel, and moves with its view."""
        if self.pointmap is None:
            return replace(self, cameras=cameras)
        with torch.autocast(self.pointmap.device.type, enabled=False):  # positions need all their bits
            local = _moved(self.cameras.camera_from_world, self.pointmap)
            lens = torch.linalg.solve(cameras.intrinsics, self.cameras.intrinsics)[:, :, None, None]
            local = (lens @ local[..., None])[..., 0]
            return replace(self, cameras=cameras, pointmap=_moved(cameras.world_from_camera, local))


def _moved(motion: Float[Tensor, "B V 4 4"], points: Float[Tensor, "B V H W 3"]) -> Float[Tensor, "B V H W 3"]:
    rotation, translation = motion[:, :, None, None, :3, :3], motion[:, :, None, None, :3, 3]
    return (rotation @ points[..., None])[..., 0] + translation


@dataclass(frozen=True)
class Attributes(Value):
    """Raw outputs of a Gaussian head, one Gaussian per pixel, before any activation.

    Args:
        opacity: Logits.
        scale: Before the adapter's activation.
        rotation: Quaternions, in the order the adapter reads, of any norm.
        color: Spherical-harmonics coefficients, colour-major; index 0 of K is the constant one.
        offset: What else moves a Gaussian from its pixel, where a backbone predicts it.
        confidence: Logits that weigh a pixel where Gaussians are fused, where a backbone predicts them.
    """

    opacity: Float[Tensor, "B V H W"]
    scale: Float[Tensor, "B V H W 3"]
    rotation: Float[Tensor, "B V H W 4"]
    color: Float[Tensor, "B V H W 3 K"]
    offset: Float[Tensor, "B V H W E"] | None = None
    confidence: Float[Tensor, "B V H W"] | None = None

    def with_(self, styled: "Attributes", names: "tuple[str, ...] | list[str]") -> "Attributes":
        """These attributes with the named ones taken from ``styled``; the others are the same tensors."""
        return replace(self, **{name: getattr(styled, name) for name in names})

    def with_degree(self, degree: int) -> "Attributes":
        """These attributes with colours cut to the spherical harmonics up to ``degree``."""
        return replace(self, color=self.color[..., : (degree + 1) ** 2])


@dataclass(frozen=True)
class Source:
    """The weights of one network.

    Scores of a stand-in for a network are comparable with those of the same stand-in only.
    """

    network: str
    file: str = ""  # its name, empty if none was read
    sha256: str = ""  # of its content, in hexadecimal
    stand_in: str | None = None

    @property
    def identity(self) -> str:
        """Equal for equal weights."""
        return f"{self.network}:{self.stand_in}:{self.sha256}"


def stand_ins(scores: Iterable[str], *sources: Source) -> dict[str, str]:
    """For each of the scores that rest on these networks, the stand-ins among them; empty where there is none."""
    names = ", ".join(dict.fromkeys(source.stand_in for source in sources if source.stand_in))
    return dict.fromkeys(scores, names) if names else {}


def checksums(*sources: Source) -> dict[str, str]:
    """The SHA-256 of every file that was read, by its name."""
    return {source.file: source.sha256 for source in sources if source.file}
