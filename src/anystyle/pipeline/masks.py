"""Where style enters: masks of photographs, or a box or a sphere in the scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d
from torch import Tensor

from anystyle.data.folder import nested_image_files
from anystyle.data.images import to_tensor
from anystyle.data.names import matched
from anystyle.data.photo_masks import are_labels, open_mask
from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.colors import fit_colors
from anystyle.pipeline.controls import Mask, SeenScene
from anystyle.types import Gaussians, SourceImage

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Sphere(Mask):
    """Style inside a sphere.

    Args:
        center: In the units and OpenCV axes of ``scene.safetensors``.
        radius: Above 0.
        soft: Width of the edge, half of it on either side.
    """

    center: Vector
    radius: float
    soft: float = 0.0

    def __post_init__(self) -> None:
        if not self.radius > 0 or not self.soft >= 0:
            raise UserError(f"a sphere of radius {self.radius} with an edge of {self.soft}; expected > 0 and >= 0")

    @property
    def text(self) -> str:
        return _text("sphere", (*self.center, self.radius), self.soft)

    def weights(self, gaussians: Gaussians, seen: SeenScene) -> Float[Tensor, "B N"]:
        """1 inside."""
        return inside((gaussians.means - gaussians.means.new_tensor(self.center)).norm(dim=-1) - self.radius, self.soft)


@dataclass(frozen=True)
class Box(Mask):
    """Style inside a box along the axes.

    Args:
        low: One corner, in the units and OpenCV axes of ``scene.safetensors``.
        high: The opposite one, larger in every coordinate.
        soft: Width of the edge, half of it on either side.
    """

    low: Vector
    high: Vector
    soft: float = 0.0

    def __post_init__(self) -> None:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)) or not self.soft >= 0:
            raise UserError(f"a box from {self.low} to {self.high} with an edge of {self.soft} has no inside")

    @property
    def text(self) -> str:
        return _text("box", (*self.low, *self.high), self.soft)

    def weights(self, gaussians: Gaussians, seen: SeenScene) -> Float[Tensor, "B N"]:
        """1 inside."""
        low, high = (gaussians.means.new_tensor(corner) for corner in (self.low, self.high))
        beyond = (gaussians.means - (low + high) / 2).abs() - (high - low) / 2
        return inside(beyond.clamp_min(0).norm(dim=-1) + beyond.amax(-1).clamp_max(0), self.soft)


@dataclass(frozen=True)
class MaskFolder(Mask):
    """Style where masks of the photographs are white: a Gaussian has the mean of the pixels that show it.

    Args:
        folder: An image named as each photograph, drawn on it as it came from the camera; dark or transparent is
            unstyled. Of a segmentation in labels or few colours all but 0 and black is styled.
        soft: Standard deviation of the blur of the masks, as a fraction of their shorter side.
    """

    folder: Path
    soft: float = 0.01

    @property
    def text(self) -> str:
        return f"{self.folder},soft={self.soft!r}"

    def weights(self, gaussians: Gaussians, seen: SeenScene) -> Float[Tensor, "B N"]:
        """The masks through the renderer."""
        files, shown = mask_files(self.folder, seen.sources), []
        labels = are_labels(files)
        for source, file in zip(seen.sources, files, strict=True):
            shown.append(to_tensor(source.of_view(open_mask(file, source.path, labels=labels).convert("RGB"))))
        masks = torch.stack(shown).to(gaussians.means)
        if self.soft > 0:
            sigma = self.soft * min(masks.shape[-2:])
            width = 2 * int(3 * sigma + 1) + 1
            kernel = tuple(min(width, side - 1 + side % 2) for side in masks.shape[-2:])
            masks = gaussian_blur2d(masks, (kernel[0], kernel[1]), (sigma, sigma), border_type="replicate")
        dark = constant_from_rgb(torch.zeros_like(gaussians.means))[:, :, None]
        with torch.enable_grad():
            lifted = fit_colors(replace(gaussians, harmonics=dark), seen.cameras, masks, seen.renderer, steps=0)
        return rgb_from_constant(lifted.harmonics[:, :, 0]).mean(-1).clamp(0, 1).detach()


def mask_files(folder: Path, sources: Sequence[SourceImage]) -> list[Path]:
    """The image in a folder that is named as each photograph, in the same folders below, or else as its view."""
    masks = {file.relative_to(folder).as_posix(): file for file in nested_image_files(folder)}
    files = [source.path or Path(source.name) for source in sources]
    found = matched(masks, files)
    views = {Path(source.name): file for source, file in zip(sources, files, strict=True) if file not in found}
    found |= {views[view]: name for view, name in matched(masks, list(views)).items()}
    if absent := [file.stem for file in files if file not in found]:
        raise UserError(f"{folder} has no mask for the photograph {absent[0]}; expected an image of its name")
    return [masks[found[file]] for file in files]


def inside(distance: Float[Tensor, "*batch"], soft: float) -> Float[Tensor, "*batch"]:
    """1 at negative signed distances, 0 at positive ones, smooth over a width of ``soft`` around the edge."""
    if soft == 0:
        return (distance <= 0).to(distance.dtype)
    way = (0.5 - distance / soft).clamp(0, 1)
    return way * way * (3 - 2 * way)


SHAPES = "sphere:X,Y,Z,RADIUS or box:X,Y,Z,X,Y,Z"


def parsed(word: str) -> Mask:
    """A mask in words: a folder or one of :data:`SHAPES`; ``,soft=WIDTH`` at its end."""
    word, _, soft = word.partition(",soft=")
    kind, _, rest = word.partition(":")
    if kind not in ("sphere", "box") and not Path(word).is_dir():
        raise UserError(f"the mask {word!r} is neither a folder nor {SHAPES}")
    reason = ""
    try:
        options = {"soft": float(soft)} if soft else {}
        if kind not in ("sphere", "box"):
            return MaskFolder(Path(word), **options)
        match kind, [float(number) for number in rest.split(",")]:
            case "sphere", [x, y, z, radius]:
                return Sphere((x, y, z), radius, **options)
            case "box", [left, top, front, right, bottom, back]:
                return Box((left, top, front), (right, bottom, back), **options)
    except ValueError as error:
        reason = f" ({error})" if isinstance(error, UserError) else ""
    raise UserError(f"the mask {word!r} is invalid{reason}; give a folder, {SHAPES}, with ,soft=WIDTH for a soft edge")


def _text(kind: str, numbers: Sequence[float], soft: float) -> str:
    return f"{kind}:{','.join(map(repr, numbers))}" + (f",soft={soft!r}" if soft else "")
