"""A wall that is known, as the scene of a painter."""

from functools import cache

import torch

import anystyle
from anystyle.methods.colors import colors_alone
from anystyle.pipeline.load import make_method
from anystyle.registry.compose import compose
from anystyle.types import Geometry, Style, Views
from tests.support.known_scene import photographed_wall, wall


@cache
def stylizer():
    return anystyle.load()


def scene():
    """The wall at cameras that are known, with Gaussians of its own."""
    from dataclasses import replace

    images, cameras, depth = photographed_wall(4)
    images = torch.nn.functional.interpolate(images, size=(48, 48), mode="bilinear", align_corners=False)
    depth = torch.nn.functional.interpolate(depth[:, None], size=(48, 48))[:, 0][None]
    cameras = cameras.resized((48, 48))
    views = Views(images[None], cameras)
    geometry = Geometry(cameras, depth, torch.ones_like(depth))
    return replace(colors_alone(replace(views, cameras=cameras)), geometry=geometry, gaussians=wall())


def painting():
    y, x = torch.meshgrid(torch.linspace(0, 18, 64), torch.linspace(0, 18, 64), indexing="ij")
    stripes = torch.stack([0.6 + 0.4 * (x + y).sin(), 0.3 + 0.2 * (x + y).sin(), 0.2 + 0.1 * y.cos()])
    return Style(image=stripes[None].clamp(0, 1), names=("stripes",))


def method(*words):
    return make_method(compose("stylize", [*words]), stylizer().style_encoder)


def run(chosen, style=None, given=None, **rest):
    style = style or painting()
    model = stylizer()
    embedding = model.embed(text=style.text) if style.image is None else model.embed(image=style.image)
    return chosen(model, given or scene(), style, embedding, **rest)
