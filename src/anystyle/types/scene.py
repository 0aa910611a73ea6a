"""Gaussians, encoded scenes and renders."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from PIL import Image
from torch import Tensor

from anystyle.io.splats import NEAR, Offset, Splats
from anystyle.types.network import Attributes, Features, Geometry, Tokens
from anystyle.types.shapes import Given, Value
from anystyle.types.views import Cameras, Views


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
class Gaussians(Given):
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

    antialiased: ClassVar[bool] = False
    """Whether renderers lower opacities by what a pixel's filter adds: see :class:`AntialiasedGaussians`."""

    def marked(self, antialiased: bool) -> "Gaussians":
        """The same Gaussians, of a training with antialiasing or without."""
        return (AntialiasedGaussians if antialiased else Gaussians)(**vars(self))

    def save(self, path: str | Path, *, scene: int = 0) -> None:
        """Write one scene of the batch as a 3DGS PLY file (see :func:`anystyle.io.ply.write`)."""
        from anystyle.io import ply

        notes = [ply.ANTIALIASED] if self.antialiased else []
        ply.write(Splats(*(getattr(self, name)[scene] for name in Splats._fields)), Path(path), notes)

    def shares(self, other: "Gaussians", names: Iterable[str]) -> bool:
        """Whether the attributes of these names are the same in both, bit for bit."""
        return all(torch.equal(getattr(self, name), getattr(other, name)) for name in names)

    @classmethod
    def load(cls, path: str | Path) -> "Gaussians":
        """Read a 3DGS PLY file as a batch of one scene (see :func:`anystyle.io.ply.read`)."""
        from anystyle.io import ply

        read = cls(*(tensor[None] for tensor in ply.read(Path(path))))
        return read.marked(any(map(ply.is_antialiased, ply.comments(Path(path)))))


@dataclass(frozen=True)
class AntialiasedGaussians(Gaussians):
    """Gaussians of a training with antialiasing, such as gsplat's ``rasterize_mode="antialiased"``.

    A renderer multiplies the opacity of each by ``sqrt(det S / det(S + eps2d I))``, with its covariance S in the image
    in pixels²: a Gaussian thinner than a pixel is fainter, as it is wider (Yu et al. 2024, Mip-Splatting).
    """

    antialiased: ClassVar[bool] = True


@dataclass(frozen=True)
class Scene(Value):
    """Everything that does not depend on style, computed once: the cache between ``encode`` and ``restyle``.

    Args:
        views: What was encoded.
        stem: From the backbone's embedder.
        features: From its aggregator.
        geometry: Cameras and depth.
        attributes: One raw Gaussian per pixel.
        clusters: Which pixels become which Gaussian; ``None`` where each is its own.
        gaussians: Fitted or given Gaussians, coloured by the pixels that a style branch predicts; ``None`` if they are
            the backbone's.
    """

    views: Views
    stem: Tokens
    features: Features
    geometry: Geometry
    attributes: Attributes
    clusters: Clusters | None
    gaussians: Gaussians | None = None

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the scene's own frame."""
        return self.geometry.cameras

    @property
    def batch(self) -> int:
        """How many scenes it holds."""
        return self.views.images.shape[0]


class Reconstructed(NamedTuple):
    """A reconstructed scene, and measured scores by name for a report."""

    scene: Scene
    measures: Mapping[str, float]


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


AXES: Mapping[str, tuple[tuple[float, float, float], ...]] = {
    "opencv": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "x": ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "-x": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}
"""The rotation to axes, by the one that points up, from OpenCV's, in which -y does."""


@dataclass(frozen=True)
class StyledScene:
    """One scene in several styles, as files hold it.

    Args:
        styles: Titles, and batches of one scene.
        cameras: A batch of one scene; it may be empty.
        names: Names of the cameras.
        notes: Lines on where the scene comes from, such as licences.
        title: To display.
        up: Axes of Gaussians and cameras' poses, one of :data:`AXES`.
        offset: What was taken off the positions of Gaussians and cameras, in these axes.
        pictures: Small images of styles that were given as one, by the titles of these.
        photographed: Whether cameras are those of photographs, and not chosen around a scene.
        sizes: Height and width in pixels of what was photographed, where it is not that of the cameras.
    """

    styles: tuple[tuple[str, Gaussians], ...]
    cameras: Cameras = field(default_factory=lambda: Cameras(torch.zeros(1, 0, 4, 4), torch.zeros(1, 0, 3, 3), (1, 1)))
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    title: str = ""
    up: str = "opencv"
    offset: Offset = NEAR
    pictures: Mapping[str, Image.Image] = field(default_factory=dict)
    photographed: bool = True
    sizes: tuple[tuple[int, int], ...] = ()

    @property
    def antialiased(self) -> bool:
        """Whether the last style was trained with antialiasing."""
        return self.styles[-1][1].antialiased

    def splats(self, style: int = -1) -> Splats:
        """The tensors of the scene in one of its styles."""
        gaussians = self.styles[style][1]
        return Splats(*(getattr(gaussians, name)[0] for name in Splats._fields))
