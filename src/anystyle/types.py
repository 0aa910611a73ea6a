"""The values that flow through the framework: frozen dataclasses of tensors.

Axis letters, everywhere: ``B`` scenes, ``V`` views, ``H W`` pixels, ``h w`` another image's pixels, ``P`` tokens a
view, ``C`` channels, ``N`` Gaussians, ``K`` spherical-harmonics coefficients, ``D`` style dimensions, ``M`` a flat
batch.

Conventions, everywhere: images are sRGB in [0, 1]; camera axes are OpenCV's (x right, y down, z forward); a pixel's
centre lies at +0.5; intrinsics are in pixels; ``a_from_b`` maps coordinates of b to coordinates of a.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import torch
import torch.nn.functional as F
import torch.utils._pytree as pytree
from jaxtyping import Bool, Float, Int
from torch import Tensor


def _flatten(value: Any) -> tuple[list[Any], tuple[str, ...]]:
    names = tuple(item.name for item in fields(value))
    return [getattr(value, name) for name in names], names


def _unflatten(cls: type, children: Any, names: Any) -> Any:
    # Not through the constructor: a pytree may hold leaves that are no tensors for a while.
    value = object.__new__(cls)
    for name, child in zip(names, children, strict=True):
        object.__setattr__(value, name, child)
    return value


# Not `Self`: the type checker of the test suite decorates methods, not classes, and reads no `Self` there.
AnyValue = TypeVar("AnyValue", bound="Value")


class Value:
    """A frozen dataclass of tensors that torch can traverse as a pytree."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        pytree.register_pytree_node(cls, _flatten, partial(_unflatten, cls))

    def map(self: AnyValue, function: Callable[[Tensor], Tensor]) -> AnyValue:
        """This value with ``function`` applied to every tensor in it."""
        return pytree.tree_map_only(Tensor, function, self)

    def to(self: AnyValue, target: torch.device | torch.dtype | str) -> AnyValue:
        """This value on another device, or with its floating-point tensors in another dtype."""
        if isinstance(target, torch.dtype):
            return self.map(lambda tensor: tensor.to(target) if tensor.is_floating_point() else tensor)
        return self.map(lambda tensor: tensor.to(target))

    def detach(self: AnyValue) -> AnyValue:
        """This value without its history of gradients."""
        return self.map(Tensor.detach)

    def expand(self: AnyValue, batch: int) -> AnyValue:
        """This value of one scene seen as ``batch`` equal scenes, without a copy."""
        return self.map(lambda tensor: tensor.expand(batch, *tensor.shape[1:]))


@dataclass(frozen=True)
class Cameras(Value):
    """Pinhole cameras in OpenCV axes.

    Args:
        world_from_camera: Rigid motions.
        intrinsics: ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` in pixels of an image of ``size``.
        size: Height and width in pixels.
    """

    world_from_camera: Float[Tensor, "B V 4 4"]
    intrinsics: Float[Tensor, "B V 3 3"]
    size: tuple[int, int]

    @property
    def camera_from_world(self) -> Float[Tensor, "B V 4 4"]:
        """The inverse rigid motions, in closed form."""
        rotation, origin = self.world_from_camera[..., :3, :3], self.world_from_camera[..., :3, 3:]
        # Sums of products, for a matrix product would be rounded under autocast.
        back = -(rotation * origin).sum(-2)[..., None]
        inverse = torch.cat([rotation.mT, back], dim=-1)
        return torch.cat([inverse, self.world_from_camera[..., 3:, :]], dim=-2)

    def resized(self, size: tuple[int, int]) -> "Cameras":
        """The same cameras for images stretched to ``size``."""
        height, width = size
        scale = self.intrinsics.new_tensor([width / self.size[1], height / self.size[0], 1.0])
        return replace(self, intrinsics=self.intrinsics * scale[:, None], size=size)

    def select(self, views: "slice | list[int] | Int[Tensor, ' V']") -> "Cameras":
        """The cameras of some views."""
        return replace(self, world_from_camera=self.world_from_camera[:, views], intrinsics=self.intrinsics[:, views])


@dataclass(frozen=True)
class Views(Value):
    """Photographs of scenes, with what is known of them.

    Args:
        images: sRGB in [0, 1].
        cameras: Where they are known.
        depth: Distance along the camera's z axis, where it is known; 0 where a pixel has none.
        names: One a view, the same for every scene of the batch; may be empty.
    """

    images: Float[Tensor, "B V 3 H W"]
    cameras: Cameras | None = None
    depth: Float[Tensor, "B V H W"] | None = None
    names: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.images.shape[-2], self.images.shape[-1]

    def select(self, views: list[int]) -> "Views":
        """Some of the views, in the order asked for."""
        return Views(
            images=self.images[:, views],
            cameras=None if self.cameras is None else self.cameras.select(views),
            depth=None if self.depth is None else self.depth[:, views],
            names=tuple(self.names[view] for view in views) if self.names else (),
        )


@dataclass(frozen=True)
class Style(Value):
    """Style references: an image, a text, or both, for each scene of a batch.

    Args:
        image: sRGB in [0, 1]; undefined where ``has_image`` is false.
        text: One description a scene; an empty one means there is none.
        has_image: Which rows of ``image`` hold one; ``None`` means all.
        names: One a style; may be empty.
        pattern: The pattern alone, from dark at 0 to light at 1, where all styles of one kind start at one place and
            none is turned: what can be learnt pixel by pixel. Known of made styles only; ``None`` elsewhere.
    """

    image: Float[Tensor, "B 3 h w"] | None = None
    text: tuple[str, ...] | None = None
    has_image: Bool[Tensor, " B"] | None = None
    names: tuple[str, ...] = ()
    pattern: Float[Tensor, "B r c"] | None = None


@dataclass(frozen=True)
class StyleEmbedding(Value):
    """A style as the network reads it.

    Args:
        vector: The embedding, of unit norm unless it is a mixture.
        direction: The normalised difference from the neutral prompt's embedding; what the CLIP losses compare with.
    """

    vector: Float[Tensor, "B D"]
    direction: Float[Tensor, "B D"]

    def toward(self, other: "StyleEmbedding", amount: "float | Float[Tensor, ' B']") -> "StyleEmbedding":
        """The point at ``amount`` in [0, 1] of the straight way to ``other``; not normalised again, as published."""
        share = torch.as_tensor(amount, dtype=self.vector.dtype, device=self.vector.device).reshape(-1, 1)
        return StyleEmbedding(
            vector=torch.lerp(self.vector, other.vector, share),
            direction=torch.lerp(self.direction, other.direction, share),
        )


@dataclass(frozen=True)
class Tokens(Value):
    """Tokens of views.

    Args:
        data: The special tokens of a view first, then its patches in row-major order.
        grid: Rows and columns of patches.
        special: How many special tokens (camera, registers) lead.
        order: Where a backbone reorders the views: the place of each token row in the input; ``None`` means in order.
        places: Where the first camera sees what each patch shows, x and y in [-1, 1] across its image and beyond;
            filled in for injectors that ask for it.
    """

    data: Float[Tensor, "B V P C"]
    grid: tuple[int, int]
    special: int = 0
    order: Int[Tensor, "B V"] | None = None
    places: Float[Tensor, "B V p 2"] | None = None

    @property
    def patches(self) -> Float[Tensor, "B V p C"]:
        """The tokens that stand for patches."""
        return self.data[:, :, self.special :]

    def with_data(self, data: Float[Tensor, "B V P C"]) -> "Tokens":
        """These tokens with other values."""
        return replace(self, data=data)

    def with_patches(self, patches: Float[Tensor, "B V p C"]) -> "Tokens":
        """These tokens with other patches and the special tokens untouched."""
        if self.special == 0:
            return replace(self, data=patches)
        return replace(self, data=torch.cat([self.data[:, :, : self.special], patches], dim=2))


Features = Mapping[int, Tokens]
"""The tokens that heads read, by the layer they were tapped at."""


@dataclass(frozen=True)
class Site:
    """A place where style may enter a network.

    Args:
        name: Part and place, such as ``aggregator/4`` or ``head/tokens/0``; the first word is the part.
        dim: Channels of the tokens there.
        tapped: Whether it is the first layer or one that a head reads; the published method injects at these.
    """

    name: str
    dim: int
    tapped: bool = True


Inject = Callable[[str, Tokens], Tokens]
"""Called with a site's name and the tokens there; returns the tokens to go on with."""


def untouched(site: str, tokens: Tokens) -> Tokens:
    """The :data:`Inject` of a network without style: every site passes its tokens on."""
    return tokens


@dataclass(frozen=True)
class Geometry(Value):
    """What a backbone knows of the shape of a scene.

    Args:
        cameras: The predicted cameras, for the input views' size.
        depth: As the backbone defines it (its adapter knows), in the scene's units.
        confidence: Of the depth, at least 0; larger is surer.
        correlation: Where a backbone matches views explicitly, and is in training: logits that cells of each view
            after the first, row by row, show what cells of the first view do.
    """

    cameras: Cameras
    depth: Float[Tensor, "B V H W"]
    confidence: Float[Tensor, "B V H W"]
    correlation: Float[Tensor, "B v r c r c"] | None = None

    def points(self, pixel_center: float = 0.5) -> Float[Tensor, "B V H W 3"]:
        """World points of every pixel, with ``depth`` read as distance along z.

        Args:
            pixel_center: Where in the pixel the ray passes; the published AnySplat weights were trained with 0.
        """
        height, width = self.depth.shape[-2:]
        intrinsics, pose = self.cameras.intrinsics, self.cameras.world_from_camera
        v = torch.arange(height, device=self.depth.device, dtype=self.depth.dtype) + pixel_center
        u = torch.arange(width, device=self.depth.device, dtype=self.depth.dtype) + pixel_center
        x = (u - intrinsics[..., 0, 2, None]) / intrinsics[..., 0, 0, None]  # B V W
        y = (v - intrinsics[..., 1, 2, None]) / intrinsics[..., 1, 1, None]  # B V H
        # Row by row of the rotation, for a matrix product would be rounded under autocast.
        rotation, origin = pose[..., :3, :3, None, None], pose[..., :3, 3, None, None]
        horizontal, vertical = x[..., None, :] * self.depth, y[..., :, None] * self.depth
        world = [
            rotation[:, :, row, 0] * horizontal
            + rotation[:, :, row, 1] * vertical
            + rotation[:, :, row, 2] * self.depth
            + origin[:, :, row]
            for row in range(3)
        ]
        return torch.stack(world, dim=-1)

    def places(self, grid: tuple[int, int]) -> Float[Tensor, "B V p 2"]:
        """Where the first camera sees what each patch shows: x and y, in [-1, 1] across its image and beyond.

        Of all views the same point has the same place, so what is laid over these places lies still in the scene
        (projective texture mapping: Segal et al. 1992). ``depth`` is read as distance along z.

        Args:
            grid: Rows and columns of patches; a patch has the mean place of its pixels.
        """
        height, width = self.depth.shape[-2:]
        first = self.cameras.world_from_camera[:, :1, None, None]  # B 1 1 1 4 4
        # Summed by hand, for a matrix product would be rounded under autocast.
        seen = ((self.points() - first[..., :3, 3])[..., :, None] * first[..., :3, :3]).sum(-2)
        # What lies behind the first camera has a place too, if none that it could see.
        away = seen[..., 2].abs().clamp_min(1e-6)
        intrinsics = self.cameras.intrinsics[:, :1, None, None]  # B 1 1 1 3 3
        x = (intrinsics[..., 0, 0] * seen[..., 0] / away + intrinsics[..., 0, 2]) * (2 / width) - 1
        y = (intrinsics[..., 1, 1] * seen[..., 1] / away + intrinsics[..., 1, 2]) * (2 / height) - 1
        places = torch.stack([x, y], dim=2)  # B V 2 H W
        if grid != (height, width):
            places = F.adaptive_avg_pool2d(places.flatten(0, 1), grid).unflatten(0, places.shape[:2])
        return places.flatten(-2).mT


@dataclass(frozen=True)
class Attributes(Value):
    """Raw outputs of a Gaussian head, one Gaussian a pixel, before any activation.

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
class Clusters(Value):
    """How pixels are fused into Gaussians; independent of style.

    Args:
        index: The Gaussian each pixel belongs to, views and pixels flattened.
        weight: Its share in that Gaussian.
        means: The fused positions.
        valid: Which Gaussians exist; scenes of a batch are padded to one count.
    """

    index: Int[Tensor, "B M"]
    weight: Float[Tensor, "B M"]
    means: Float[Tensor, "B N 3"]
    valid: Bool[Tensor, "B N"]


@dataclass(frozen=True)
class Gaussians(Value):
    """3D Gaussians in world space.

    Args:
        means: Centres.
        rotations: Quaternions wxyz, of any norm; renderers normalise.
        scales: Standard deviations, at least 0.
        opacities: In [0, 1]; a padded Gaussian has 0.
        harmonics: Colour is ``max(sum_k Y_k(direction) * harmonics_k + 0.5, 0)``, as in 3DGS.
    """

    means: Float[Tensor, "B N 3"]
    rotations: Float[Tensor, "B N 4"]
    scales: Float[Tensor, "B N 3"]
    opacities: Float[Tensor, "B N"]
    harmonics: Float[Tensor, "B N K 3"]

    def save(self, path: str | Path, *, scene: int = 0, y_up: bool = False) -> None:
        """Write one scene as a 3DGS PLY file (see :func:`anystyle.ply.write`)."""
        from anystyle import ply

        ply.write(self, Path(path), scene=scene, y_up=y_up)

    @classmethod
    def load(cls, path: str | Path) -> "Gaussians":
        """Read a 3DGS PLY file as a batch of one scene (see :func:`anystyle.ply.read`)."""
        from anystyle import ply

        return ply.read(Path(path))


@dataclass(frozen=True)
class Scene(Value):
    """All that does not depend on style, computed once: the cache between ``encode`` and ``restyle``."""

    views: Views
    stem: Tokens
    features: Features
    geometry: Geometry
    attributes: Attributes
    clusters: Clusters | None

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the scene's own frame."""
        return self.geometry.cameras

    @property
    def batch(self) -> int:
        """How many scenes it holds."""
        return self.views.images.shape[0]


@dataclass(frozen=True)
class Renders(Value):
    """Rendered images.

    Args:
        color: In [0, 1], over the renderer's background.
        depth: Accumulated ``sum w z``; divide by ``alpha`` for the expected depth.
        alpha: Accumulated opacity in [0, 1].
    """

    color: Float[Tensor, "B V 3 H W"]
    depth: Float[Tensor, "B V H W"]
    alpha: Float[Tensor, "B V H W"]


@dataclass(frozen=True)
class Comparison(Value):
    """What a metric needs of stylized scenes; also built from folders of images.

    Args:
        content: The photographs.
        stylized: The results, view by view.
        style: The references.
        cameras: Of the views, where known.
        depth: Distance along z in each view, where known; 0 where there is none.
        scenes: One name a row of the batch.
        styles: One name a row of the batch.
        seconds: That each row took, from the style to the rendered views, where known.
    """

    content: Float[Tensor, "B V 3 H W"]
    stylized: Float[Tensor, "B V 3 H W"]
    style: Style | None = None
    cameras: Cameras | None = None
    depth: Float[Tensor, "B V H W"] | None = None
    scenes: tuple[str, ...] = ()
    styles: tuple[str, ...] = ()
    seconds: Float[Tensor, " B"] | None = None


@dataclass(frozen=True)
class Stylization(Value):
    """A stylized scene with all that led to it: what every loss sees."""

    views: Views
    style: Style
    embedding: StyleEmbedding
    scene: Scene
    gaussians: Gaussians
    renders: Renders

    def comparison(self) -> Comparison:
        """What metrics compare."""
        return Comparison(
            content=self.views.images,
            stylized=self.renders.color,
            style=self.style,
            cameras=self.scene.cameras,
            depth=self.renders.depth / self.renders.alpha.clamp_min(1e-6),
        )


@dataclass(frozen=True)
class Frames(Value):
    """Single images with what is known of each: what correspondences are computed between.

    Args:
        images: sRGB in [0, 1].
        depth: Distance along z; 0 where there is none.
        world_from_camera: Rigid motions in OpenCV axes.
        intrinsics: In pixels.
    """

    images: Float[Tensor, "M 3 H W"]
    depth: Float[Tensor, "M H W"] | None = None
    world_from_camera: Float[Tensor, "M 4 4"] | None = None
    intrinsics: Float[Tensor, "M 3 3"] | None = None


@dataclass(frozen=True)
class Flow(Value):
    """Where each pixel of a source frame is seen in a target frame.

    Args:
        displacement: (x, y) in pixels, to be added to the source pixel.
        visible: Whether the point is seen in the target.
    """

    displacement: Float[Tensor, "M 2 H W"]
    visible: Bool[Tensor, "M H W"]
