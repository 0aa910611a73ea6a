"""Where scenes and styles come from; how a scene comes to be, takes a style, and is shown."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, ClassVar, TypeVar

from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.registry.catalog import Pluggable
from anystyle.types import (
    Cameras,
    Gaussians,
    OnProgress,
    Reconstructed,
    Renders,
    Scene,
    Source,
    Style,
    StyleEmbedding,
    Views,
    no_progress,
)

if TYPE_CHECKING:
    from anystyle.stylizer import Stylizer


class SceneSource(Pluggable, ABC):
    """Scenes to learn from or to be judged on, read at random; all views of one scene have one size."""

    runtime = ("resolution", "patch_size")

    @abstractmethod
    def __len__(self) -> int:
        """How many scenes there are."""

    @abstractmethod
    def name(self, scene: int) -> str:
        """A name for a scene, unique within the source."""

    @abstractmethod
    def num_views(self, scene: int) -> int:
        """How many views a scene has, in capture order."""

    @abstractmethod
    def read(self, scene: int, views: Sequence[int]) -> Views:
        """Some views of one scene as a batch of one, on the CPU; nothing else is decoded."""


class StyleSource(Pluggable, ABC):
    """Styles to learn from or to be judged on, read at random; all images have one size."""

    @abstractmethod
    def __len__(self) -> int:
        """How many styles there are."""

    @abstractmethod
    def read(self, style: int) -> Style:
        """One style as a batch of one, on the CPU."""


_Source = TypeVar("_Source", SceneSource, StyleSource)


def required(source: _Source | None, kind: str) -> _Source:
    """A source that a training or a protocol needs; raises a :class:`UserError` if none is configured."""
    if source is None:
        raise UserError(f"this needs {kind}; add {kind}=NAME (`anystyle plugins {kind}` lists them)")
    return source


class LinearView(ABC):
    """One view of one scene as a linear map of constant colours: a pixel mixes those of the Gaussians that it shows."""

    background: Float[Tensor, "3 H W"]
    """What is seen of the background."""
    render: Renders
    """The view of the scene with the colours that it was given."""
    nbytes: int
    """Memory that it takes."""

    @abstractmethod
    def __call__(self, colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
        """The view of any numbers in place of colours, without the background, not clamped."""

    @abstractmethod
    def transposed(self, pixels: Float[Tensor, "3 H W"]) -> Float[Tensor, "N 3"]:
        """For each Gaussian the sum of pixels, weighted by its shares in them."""


class Renderer(Pluggable, ABC):
    """A differentiable 3DGS rasteriser."""

    devices: ClassVar[tuple[str, ...]] = ()
    """The types of device that it runs on, as in ``torch.device.type``; empty for any."""
    priority: ClassVar[int] = 0
    """``renderer=auto`` takes the renderer of the highest priority among those that run on the tensors' device, of
    equal ones the first by name, and gives it the options ``background, near, far, eps2d``. 0: never taken; 1: plain
    PyTorch; 10: the kernels that come with anystyle."""

    @classmethod
    def lacks(cls) -> str | None:
        """What it needs and is not on this machine, and what to install, after "the renderer ..."; ``None`` if it runs.

        ``renderer=auto`` asks before it takes one.
        """
        return None

    @abstractmethod
    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene, differentiable in the Gaussians and the camera poses.

        Opacities of :class:`~anystyle.types.AntialiasedGaussians` are lowered as that class says.
        """

    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView | None:
        """A view of one scene, if the renderer has a faster way to it and to its transpose than its gradient."""
        return None


class Reconstruction(Pluggable, ABC):
    """From the views of one scene to the scene that is styled; run once per scene."""

    needs_cameras: ClassVar[bool] = False
    """Whether views must come with cameras. One that does takes all views at once; others may get them in groups."""

    short_side: int | None = None
    """Shorter side in pixels that it is best given views at; smaller photographs stay as they are. ``None`` is the
    backbone's resolution."""

    max_views: int = 48
    """The most photographs of a scene that are read where ``views.take`` sets no number."""

    @abstractmethod
    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        on_progress: OnProgress = no_progress,
    ) -> Reconstructed:
        """Reconstruct one scene, in the frame of its cameras where these are known.

        Args:
            views: A batch of one; with cameras if they are needed.
            encode: Encodes views in the backbone's single pass.
            renderer: Differentiable; the one that will show the scene.
            points: For each view, sparse points in world space that it shows, where some are known.
            on_progress: Called every few seconds.

        Raises:
            UserError: The views do not suffice, or lack cameras.
        """


class Method(Pluggable, ABC):
    """Stylizes one scene at a time; a constructor argument ``losses`` is passed by the framework, by name."""

    runtime = ("losses",)

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks that it uses beside the stylizer's, for reports."""
        return ()

    @abstractmethod
    def __call__(
        self,
        stylizer: "Stylizer",
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        """Stylize one scene, without changing it.

        Args:
            stylizer: Encoded the scene and the style, and renders.
            scene: A batch of one.
            style: Image, text, or neither where the style is a point between two; a batch of one.
            embedding: The style, embedded by the stylizer's encoder.
            on_progress: Called every few seconds.

        Returns:
            In the scene's frame, free of gradients.

        Raises:
            UserError: The style or the stylizer lacks what the method needs.
        """
