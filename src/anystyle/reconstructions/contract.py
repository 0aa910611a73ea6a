"""What a reconstruction promises: how views of a scene become what is styled."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.registry.socket import Socket
from anystyle.types import Reconstructed, Scene, Views


def silent(line: str) -> None:
    """Tell nobody."""


class Reconstruction(Socket, ABC):
    """From the views of one scene to what is styled: all that is done once a scene."""

    needs_cameras: ClassVar[bool] = False
    """Whether views must come with cameras. One that does takes all views at once; others may get them in groups."""

    short_side: int | None = None
    """Shorter side in pixels that it is best given views at; smaller photographs stay as they are. ``None`` is the
    backbone's resolution."""

    @abstractmethod
    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        progress: Callable[[str], None] = silent,
    ) -> Reconstructed:
        """Reconstruct one scene, in the frame of its cameras where these are known.

        Args:
            views: A batch of one; with cameras if they are needed.
            encode: What the backbone knows of views, in a single pass.
            renderer: Differentiable, and what the scene is going to be shown by.
            points: For each view, points in world space that it shows, where some are known.
            progress: Told in a line where it is, every few seconds.

        Raises:
            ValueError: The views do not suffice, or lack cameras.
        """
