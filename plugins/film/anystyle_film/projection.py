"""How a frame of a film is made of images that pinhole cameras see."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras
from anystyle_film.scene import FilmedScene


@dataclass(frozen=True)
class Layout:
    """What players have to know of a frame.

    Args:
        degrees: That an equirectangular frame, or each half of it, spans from left to right; 0 is an ordinary picture.
        stereo: Whether the left half is for the left eye and the right half for the right one.
    """

    degrees: int = 0
    stereo: bool = False


class Projection(ABC):
    """How a frame is made of images that pinhole cameras see."""

    layout: ClassVar[Layout] = Layout()

    @abstractmethod
    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        """Height and width of a frame in pixels, even.

        Args:
            cameras: Of the capture.
            scale: Size relative to the images of these cameras.
            height: Instead of the scale.
        """

    @abstractmethod
    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        """The pinhole cameras whose images a frame of this size is made of.

        Args:
            scene: What is filmed.
            camera: A single one, of the path.
            size: Of the frame.
        """

    @abstractmethod
    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        """A frame, of the images of all :meth:`views` in their order."""
