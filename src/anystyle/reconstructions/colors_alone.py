"""A scene that holds colours of pixels and nothing of a network."""

import torch

from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.types import Attributes, Cameras, Geometry, Scene, Tokens, Views


def colors_alone(views: Views, cameras: Cameras) -> Scene:
    """Views as a style branch at the colours of pixels reads them: no tokens, and no depth or Gaussian yet."""
    images = views.images
    batch, number, _, height, width = images.shape
    pixels = images.new_zeros(batch, number, height, width)
    rotation = torch.tensor([1.0, 0.0, 0.0, 0.0]).to(images).expand(*pixels.shape, 4)
    return Scene(
        views=views,
        stem=Tokens(images.new_zeros(batch, number, 0, 0), grid=(0, 0)),
        features={},
        geometry=Geometry(cameras, pixels, pixels),
        attributes=Attributes(
            opacity=pixels,
            scale=pixels[..., None].expand(*pixels.shape, 3),
            rotation=rotation,
            color=constant_from_rgb(images.movedim(2, -1))[..., None],
        ),
        clusters=None,
    )
