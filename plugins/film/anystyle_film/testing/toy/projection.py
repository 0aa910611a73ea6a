"""A pinhole image in black and white: the smallest projection."""

from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras
from anystyle_film.contract import Projection
from anystyle_film.scene import FilmedScene


class ToyProjection(Projection):
    """One pinhole image without colour."""

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        scale = scale if height is None else height / cameras.size[0]
        high, wide = (max(2, round(side * scale / 2) * 2) for side in cameras.size)
        return high, wide

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        return camera.resized(size)

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        return images[0].mean(0, keepdim=True).expand(3, -1, -1)
