"""Inputs that the tests of vision, losses and style encoders share."""

import atexit
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named
from anystyle.types import (
    Attributes,
    Cameras,
    Gaussians,
    Geometry,
    Renders,
    Scene,
    Style,
    StyleEmbedding,
    Stylization,
    Tokens,
    Views,
)
from anystyle.vision import weights
from anystyle.vision.vgg import VGG19

# The goldens fill VGG by name with the gain of a rectifier.
VGG_RULES = [[r"\.weight$", {"scale": 2**0.5}]]


@cache
def filled_vgg_file(*, gain: bool = True) -> Path:
    """A file with the goldens' VGG-19, under the published name and keys; Styl3R's is filled without the gain."""
    folder = mkdtemp(prefix="anystyle-vgg-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = Path(folder) / weights.row("vgg19").file
    torch.save(fill_named(VGG19().state_dict(), VGG_RULES if gain else ()), path)
    return path


def cameras(batch: int, views: int, size: tuple[int, int]) -> Cameras:
    """Cameras at the origin that look along z."""
    height, width = size
    intrinsics = torch.tensor([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    return Cameras(torch.eye(4).expand(batch, views, 4, 4), intrinsics.expand(batch, views, 3, 3), size)


def stylization(
    rendered: Tensor,
    photographs: Tensor,
    style: Tensor | None = None,
    *,
    has_image: Tensor | None = None,
    direction: Tensor | None = None,
    rendered_depth: Tensor | None = None,
    geometry: Geometry | None = None,
) -> Stylization:
    """A stylization of the given images; what the losses under test do not read is small and constant."""
    batch, num_views, _, height, width = photographs.shape
    maps = torch.ones(batch, num_views, height, width)
    geometry = geometry or Geometry(cameras(batch, num_views, (height, width)), maps, maps)
    tokens = Tokens(torch.zeros(batch, num_views, 1, 1), (1, 1))
    attributes = Attributes(
        opacity=maps,
        scale=maps[..., None].expand(*maps.shape, 3),
        rotation=maps[..., None].expand(*maps.shape, 4),
        color=maps[..., None, None].expand(*maps.shape, 3, 1),
    )
    views = Views(photographs)
    direction = torch.ones(batch, 1) if direction is None else direction
    return Stylization(
        views=views,
        style=Style(image=style, has_image=has_image),
        embedding=StyleEmbedding(direction, direction),
        scene=Scene(views, tokens, {}, geometry, attributes, None),
        gaussians=Gaussians(
            means=torch.zeros(batch, 1, 3),
            rotations=torch.ones(batch, 1, 4),
            scales=torch.ones(batch, 1, 3),
            opacities=torch.ones(batch, 1),
            harmonics=torch.zeros(batch, 1, 1, 3),
        ),
        renders=Renders(rendered, maps if rendered_depth is None else rendered_depth, maps),
    )
