"""Lenses with radial and tangential distortion, and photographs without it."""

import math
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.contracts import Undistortion
from anystyle.errors import UserError
from anystyle.io.colmap import Camera
from anystyle_captures.sfm.colmap import load_pycolmap

MAX_SIDE = 1 << 20
"""Pixels that an image may be wide or high for a camera of it to be believed."""
PANORAMAS = "poses=sfm cuts them; beside a scene of Gaussians, splat.folder=EMPTY_FOLDER chooses cameras around it"
"""What to do about cameras of panoramas."""
NEGLIGIBLE = 0.1
"""Displacement in pixels, anywhere in the photograph, that is not corrected."""
MAX_SLOPE = 2.5
"""The largest slope of rays in an undistorted photograph: what lies further than 68 degrees off the axis is cut off."""


@dataclass(frozen=True)
class Lens:
    """Brown's model in OpenCV's order, or with ``fisheye`` that of Kannala and Brandt.

    A ray (x, y) at z = 1, of a fisheye scaled from tan(a) to the angle a, is seen at ``(fx, fy) d(x, y) + (cx, cy)``.

    Args:
        size: Height and width in pixels.
        focal: fx and fy in pixels.
        center: cx and cy in pixels from the upper left corner, (0.5, 0.5) in the middle of the first pixel.
        radial: k1 to k4, of r², r⁴, r⁶ and r⁸.
        tangential: p1 and p2: x gains ``2 p1 x y + p2 (r² + 2 x²)``, y ``p1 (r² + 2 y²) + 2 p2 x y``.
        fisheye: Whether the radius is the angle from the axis.
        colmap: A camera of a model that the terms do not cover; pycolmap projects by it.
    """

    size: tuple[int, int]
    focal: tuple[float, float]
    center: tuple[float, float]
    radial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)
    fisheye: bool = False
    colmap: Camera | None = None

    def __post_init__(self) -> None:
        values = (*self.size, *self.focal, *self.center, *self.radial, *self.tangential)
        sizes = all(1 <= side <= MAX_SIDE for side in self.size) and all(focal > 0 for focal in self.focal)
        if not (sizes and all(map(math.isfinite, values))):
            height, width = self.size
            raise UserError(f"a camera of {width}x{height} pixels with focal lengths {self.focal} is invalid")

    def matrix(self, scale: float = 1.0) -> Float[np.ndarray, "3 3"]:
        """Intrinsics without distortion, for focal lengths that are ``scale`` times as long."""
        (fx, fy), (cx, cy) = self.focal, self.center
        return np.array([[scale * fx, 0.0, cx], [0.0, scale * fy, cy], [0.0, 0.0, 1.0]])

    def pixels(self, rays: Float[Tensor, "*N 2"]) -> Float[Tensor, "*N 2"]:
        """Where rays (x, y) at z = 1 are seen, in pixels; not a number where they are not."""
        if self.colmap is not None:
            return _projected(self.colmap, rays)
        if self.fisheye:
            slope = rays.norm(dim=-1, keepdim=True).clamp_min(1e-12)
            rays = rays * (slope.atan() / slope)
        x, y = rays.unbind(-1)
        squared, factor = x * x + y * y, torch.zeros_like(x)
        for k in reversed(self.radial):
            factor = (factor + k) * squared
        p1, p2 = self.tangential
        u = x * (1 + factor) + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
        v = y * (1 + factor) + p1 * (squared + 2 * y * y) + 2 * p2 * x * y
        return torch.stack([u, v], dim=-1) * rays.new_tensor(self.focal) + rays.new_tensor(self.center)

    def undistortion(self) -> Undistortion | None:
        """What makes a photograph one of a pinhole camera, if it is not one."""
        rays = self._rays(self._grid(33), 1.0)
        if not self.fisheye and float((self.pixels(rays) - self._grid(33)).abs().max()) <= NEGLIGIBLE:
            return None
        return Undistortion(partial(_undistorted, self), self.matrix(_pinhole_scale(self)))

    def _grid(self, number: int) -> Float[Tensor, "M M 2"]:
        """Pixels from corner to corner."""
        steps = torch.linspace(0, 1, number, dtype=torch.float64)
        v, u = torch.meshgrid(self.size[0] * steps, self.size[1] * steps, indexing="ij")
        return torch.stack([u, v], dim=-1)

    def _rays(self, pixels: Float[Tensor, "*N 2"], scale: float) -> Float[Tensor, "*N 2"]:
        """Rays of pixels of the pinhole camera whose focal lengths are ``scale`` times the lens's."""
        return (pixels - pixels.new_tensor(self.center)) / (scale * pixels.new_tensor(self.focal))


def _projected(camera: Camera, rays: Float[Tensor, "*N 2"]) -> Float[Tensor, "*N 2"]:
    try:
        load_pycolmap()
        import pycolmap
    except ImportError:
        raise UserError(
            f"cameras of the model {camera.model} are read with pycolmap: pip install pycolmap, or undistort the "
            "photographs first (colmap image_undistorter)"
        ) from None
    height, width = camera.size
    lens = pycolmap.Camera(model=camera.model, width=width, height=height, params=list(camera.parameters))
    points = F.pad(rays.reshape(-1, 2).double(), (0, 1), value=1.0)
    return torch.from_numpy(lens.img_from_cam(points.numpy())).reshape(rays.shape).to(rays)


@cache
def _pinhole_scale(lens: Lens) -> float:
    """The smallest scale of the focal lengths whose whole picture the photograph shows.

    It is sought from long focal lengths on, because far from the axis a polynomial leads back into the photograph.
    """
    grid = lens._grid(65)
    border = torch.cat([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    largest, center = border.new_tensor([lens.size[1], lens.size[0]]), border.new_tensor(lens.center)

    def radii(scale: float) -> Tensor | None:
        """Radii of the border as the photograph shows it; ``None`` if it does not show all."""
        rays = lens._rays(border, scale)
        seen = lens.pixels(rays)
        shown = bool(((seen >= -1e-6) & (seen <= largest + 1e-6)).all()) and float(rays.norm(dim=-1).max()) <= MAX_SLOPE
        return (seen - center).norm(dim=-1) if shown else None

    step, scale, radius = 0.97, 8.0, radii(8.0)
    if radius is None:
        raise UserError("the distortion of a lens leaves nothing of its photograph; export undistorted photographs")
    while step < 0.99999:
        wider = radii(scale * step)
        if wider is not None and bool((wider > radius).all()):
            scale, radius = scale * step, wider
        else:
            step = step**0.5
    return scale


def _undistorted(lens: Lens, picture: Image.Image) -> Image.Image:
    """A picture of the lens as its pinhole camera would have taken it, bilinearly resampled."""
    height, width = picture.height, picture.width
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    stored = torch.tensor([lens.size[1], lens.size[0]], dtype=torch.float64)
    pixels = torch.stack([u, v], dim=-1).double() * stored / torch.tensor([width, height])
    grid = (2 * lens.pixels(lens._rays(pixels, _pinhole_scale(lens))) / stored - 1).float()
    image = torch.from_numpy(np.array(picture.convert("RGB"))).permute(2, 0, 1).float()
    sampled = F.grid_sample(image[None], grid[None], align_corners=False, padding_mode="border")[0]
    return Image.fromarray(sampled.round().byte().permute(1, 2, 0).numpy())
