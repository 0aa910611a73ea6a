"""Inputs of losses, metrics and correspondences."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.types.network import StyleEmbedding
from anystyle.types.scene import Gaussians, Renders, Scene
from anystyle.types.shapes import Value
from anystyle.types.views import Cameras, Style, Views


@dataclass(frozen=True)
class Comparison(Value):
    """What a metric needs of stylized scenes; also built from folders of images.

    Args:
        content: The photographs.
        stylized: The results, view by view.
        style: The references.
        cameras: The cameras of the views, where known.
        depth: Distance along z in each view, where known; 0 where there is none.
        scenes: One name per row of the batch.
        styles: One name per row of the batch.
        numbers: The views' numbers in the sequence they were taken from, ascending; they follow each other if empty.
        seconds: What each row took, from the style to the rendered views, where known.
    """

    content: Float[Tensor, "B V 3 H W"]
    stylized: Float[Tensor, "B V 3 H W"]
    style: Style | None = None
    cameras: Cameras | None = None
    depth: Float[Tensor, "B V H W"] | None = None
    scenes: tuple[str, ...] = ()
    styles: tuple[str, ...] = ()
    seconds: Float[Tensor, " B"] | None = None
    numbers: tuple[int, ...] = ()

    def neighbours(self, gap: int = 1) -> list[tuple[int, int]]:
        """The places of every view and of the one that is ``gap`` later in the sequence, where both are there.

        Example:
            >>> import torch
            >>> views = torch.zeros(1, 3, 3, 8, 8)
            >>> Comparison(views, views, numbers=(0, 1, 3)).neighbours()
            [(0, 1)]
        """
        places = {number: place for place, number in enumerate(self.numbers or range(self.stylized.shape[1]))}
        return [(place, places[number + gap]) for number, place in places.items() if number + gap in places]


@dataclass(frozen=True)
class Stylization(Value):
    """A stylized scene with all that led to it: what every loss sees.

    Args:
        views: The photographs.
        style: Image, text, or both of each scene.
        embedding: What the style entered as.
        scene: As the backbone encoded it.
        gaussians: Stylized.
        renders: Renders of the stylized scene at the scene's own cameras.
        unstyled: Renders of the scene without a style, where a loss asks for it (``Loss.needs_unstyled``).
        identity: Renders of the scene in the style of its first photograph, where a loss asks for it
            (``Loss.needs_identity``).
    """

    views: Views
    style: Style
    embedding: StyleEmbedding
    scene: Scene
    gaussians: Gaussians
    renders: Renders
    unstyled: Renders | None = None
    identity: Renders | None = None

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
