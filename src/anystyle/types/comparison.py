"""Inputs of losses, metrics and correspondences."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types.network import StyleEmbedding
from anystyle.types.scene import Gaussians, Renders, Scene
from anystyle.types.shapes import ShapeError, Value, check_fields, check_tensor, kind_and_shape
from anystyle.types.views import Cameras, Style, Views

ROUNDING = 1e-3
"""How far outside of [0, 1] values of images may lie."""


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

    @classmethod
    def from_images(
        cls,
        preds: Tensor,
        target: Tensor | None = None,
        style: Tensor | Sequence[str] | Style | None = None,
        *,
        cameras: Cameras | None = None,
        depth: Tensor | None = None,
        seconds: Tensor | None = None,
        scenes: Sequence[str] = (),
        numbers: Sequence[int] = (),
    ) -> "Comparison":
        """Images ``[N, 3, H, W]``, each a scene of one view, or scenes ``[B, V, 3, H, W]``; sRGB in [0, 1].

        Args:
            preds: The stylized images.
            target: The photographs, as many of the same size; ``preds`` again if a metric has no use for them.
            style: A style image for each scene, ``[B, 3, h, w]``, or one for all, ``[1, 3, h, w]``; or a text for each.
            cameras: The cameras of the views, where known.
            depth: Distance along z, ``[B, V, H, W]``, where known; 0 where there is none.
            seconds: What each scene took, ``[B]``, where known.
            scenes: A name for each; scenes without names are one scene in several styles.
            numbers: The views' numbers in their sequence, ascending.

        Raises:
            ShapeError: An argument, which is named, has another shape, type or range.
        """
        stylized = _images(preds, "preds")
        content = stylized if target is None else _images(target, "target")
        if target is not None and content.shape != stylized.shape:
            raise ShapeError(f"target is {kind_and_shape(target)}", f"the shape of preds, {list(preds.shape)}")
        rows = stylized.shape[0]
        if isinstance(style, Tensor):
            check_tensor(style, Float[Tensor, "B 3 h w"], "style")
            images = _images(style, "style")[:, 0]
            style = Style(images.expand(rows, -1, -1, -1) if len(images) == 1 else images)
        elif isinstance(style, Style):
            if len(shown := _shown(style)):
                _images(shown, "style")
        elif style is not None:
            style = Style(text=tuple(style))
        if len(numbers) not in (0, stylized.shape[1]):
            raise ShapeError(f"numbers has {len(numbers)} numbers", f"one for each of {stylized.shape[1]} views")
        for name, words in (("scenes", scenes), ("style", style.text if style else None)):
            if words and len(words) != rows:
                raise ShapeError(f"{name} has {len(words)} names", f"one for each of {rows} scenes")
        given = cls(content, stylized, style, cameras, depth, tuple(scenes), (), seconds, tuple(numbers))
        check_fields(given)
        return given

    def checked(self) -> "Comparison":
        """This comparison, as :meth:`Metric.update` gets it.

        Raises:
            UserError: Photographs and stylized images are not of one size, or an image has values that are not finite.
        """
        where = " in style ".join([*self.scenes[:1], *self.styles[:1]]) + ": " if self.scenes else ""
        if self.content.shape != self.stylized.shape:
            photographs, others = (
                f"{rows} x {views} of {width}x{height} pixels"
                for rows, views, _, height, width in (self.content.shape, self.stylized.shape)
            )
            raise UserError(
                f"{where}photographs are {photographs} and stylized images {others}; give as many of one size"
            )
        if len(self.numbers) not in (0, self.stylized.shape[1]):
            raise UserError(f"{where}{self.stylized.shape[1]} views have {len(self.numbers)} numbers; give one each")
        parts = {"the photographs": self.content, "the stylized images": self.stylized}
        if self.style is not None:
            parts["the style images"] = _shown(self.style)
        for what, images in parts.items():
            images = images[:1] if images.stride(0) == 0 else images
            # Adding is a tenth of the work of testing each value.
            if not images.sum().isfinite() and (bad := int((~torch.isfinite(images)).sum())):
                raise UserError(
                    f"{where}{what} hold {bad} values that are NaN or infinite; a metric needs numbers in [0, 1]"
                )
        return self

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


def _shown(style: Style) -> Float[Tensor, "N 3 h w"]:
    """The images of the rows that have one."""
    if style.image is None:
        return torch.zeros(0, 3, 1, 1)
    return style.image if style.has_image is None else style.image[style.has_image]


def _images(images: Tensor, name: str) -> Float[Tensor, "B V 3 H W"]:
    several = isinstance(images, Tensor) and images.ndim == 5
    check_tensor(images, Float[Tensor, "B V 3 H W"] if several else Float[Tensor, "N 3 H W"], name)
    if not images.numel():
        raise ShapeError(f"{name} is {kind_and_shape(images)}", "at least one image")
    low, high = map(float, images.aminmax())
    if not (low >= -ROUNDING and high <= 1 + ROUNDING):  # nan is neither
        ways = f"{name} / 255, ({name} + 1) / 2 or {name}.clamp(0, 1) may bring them there"
        raise ShapeError(f"{name} with values from {low:.4g} to {high:.4g}", "sRGB in [0, 1]", ways)
    return (images if several else images[:, None]).float()
