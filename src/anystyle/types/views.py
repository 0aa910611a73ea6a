"""Inputs: photographs, cameras and styles."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types.value import Given


@dataclass(frozen=True)
class Cameras(Given):
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
class Views(Given):
    """Photographs of scenes, with what is known of them.

    Args:
        images: sRGB in [0, 1].
        cameras: Where they are known.
        depth: Distance along the camera's z axis, where it is known; 0 where a pixel has none.
        names: One a view, the same for every scene of the batch; may be empty.
        alpha: How much of a pixel is covered, in [0, 1]: where it is 0, nothing is there. The images are over white.
            ``None`` is 1 everywhere.
        counted: Where a photograph is to be learnt from; elsewhere it shows what is not part of the scene, such as
            passers-by, and tells nothing of what is behind. ``None`` is everywhere.
    """

    images: Float[Tensor, "B V 3 H W"]
    cameras: Cameras | None = None
    depth: Float[Tensor, "B V H W"] | None = None
    names: tuple[str, ...] = ()
    alpha: Float[Tensor, "B V H W"] | None = None
    counted: Bool[Tensor, "B V H W"] | None = None

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
            alpha=None if self.alpha is None else self.alpha[:, views],
            counted=None if self.counted is None else self.counted[:, views],
        )


@dataclass(frozen=True)
class Style(Given):
    """Style references: an image, a text, or both, for each scene of a batch.

    Args:
        image: sRGB in [0, 1]; undefined where ``has_image`` is false.
        text: One description a scene; an empty one means there is none.
        has_image: Which rows of ``image`` hold one; ``None`` means all.
        names: One a style; may be empty.
    """

    image: Float[Tensor, "B 3 h w"] | None = None
    text: tuple[str, ...] | None = None
    has_image: Bool[Tensor, " B"] | None = None
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class StyleEmbedding(Given):
    """A style as the network reads it.

    Args:
        vector: The embedding, as the style encoder gives it, or a mixture of two.
        direction: The normalised difference from the neutral prompt's embedding; what the CLIP losses compare with.
        scale: Size of strokes, relative to the model's own.
    """

    vector: Float[Tensor, "B D"]
    direction: Float[Tensor, "B D"]
    scale: float = 1.0

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
        return StyleEmbedding(
            vector=torch.lerp(self.vector, other.vector, weight),
            direction=torch.lerp(self.direction, other.direction, weight),
            scale=self.scale,
        )


@dataclass(frozen=True)
class TextMatch:
    """The nearest description to a text that a style encoder knows, and words of the text that it does not know.

    The similarity is by a measure of the encoder; 1 is the same. ``remedy`` is how unknown words are handled, or what
    would help.
    """

    text: str
    description: str
    similarity: float
    unknown_words: tuple[str, ...]
    remedy: str = ""
