"""What a reconstruction promises: see :class:`anystyle.contracts.Reconstruction`."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch
import torch.nn.functional as F

from anystyle.contracts import Reconstruction
from anystyle.testing import asserts
from anystyle.testing.asserts import ONE_LINE
from anystyle.testing.inputs import cameras, generator
from anystyle.testing.subject import Subject
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import Attributes, Gaussians, Geometry, Reconstructed, Views
from anystyle.types.seeds import seeded
from anystyle.types.shapes import check_value

SIZE, NUMBER = (48, 64), 4


def test_makes_a_scene_of_the_views(plugin: Subject[Reconstruction]) -> None:
    """It gives cameras, depth and attributes of every view, its own Gaussians or none, and finite measures."""
    scene, measures = _once(plugin)
    sizes = {"B": 1, "V": NUMBER, "H": SIZE[0], "W": SIZE[1]}
    check_value(scene.geometry, Geometry, "the reconstruction", **sizes)
    check_value(scene.attributes, Attributes, "the reconstruction", **sizes)
    if scene.gaussians is not None:
        check_value(scene.gaussians, Gaussians, "the reconstruction", B=1)
    asserts.finite((scene.geometry, scene.gaussians), "the scene")
    assert (scene.views.images.shape[1], scene.views.size) == (NUMBER, SIZE), "other views than those that were given"
    assert all(math.isfinite(value) for value in measures.values()), f"measures that are not finite: {measures}"


def test_cameras_are_kept_or_asked_for(plugin: Subject[Reconstruction]) -> None:
    """Where it needs cameras, the scene has those of the views, and views without them raise a ValueError."""
    if plugin.instance.needs_cameras:
        asserts.close(_once(plugin).scene.cameras, cameras(1, NUMBER, SIZE), "the scene's cameras")
        with pytest.raises(ValueError, match=ONE_LINE):
            _run(plugin, replace(photographs(), cameras=None))


def test_gives_the_same_twice(plugin: Subject[Reconstruction]) -> None:
    """A new instance makes the same scene of the same views, and writes into none of them."""
    given, first = photographs(), _once(plugin).scene
    second = _run(plugin, given).scene
    asserts.same(second.gaussians or second.attributes, first.gaussians or first.attributes, "a second run")
    asserts.same(given, photographs(), "the views")


def photographs() -> Views:
    """Photographs of a coloured wall in the plane z = 0, with cameras."""
    seen = cameras(1, NUMBER, SIZE)
    texture = torch.rand(1, 3, 24, 24, generator=generator(11))
    unit = Geometry(seen, torch.ones(1, NUMBER, *SIZE), torch.ones(1, NUMBER, *SIZE)).points()[0]  # V H W 3
    center = seen.world_from_camera[0, :, None, None, :3, 3]
    ray = unit - center
    wall = center - ray * (center[..., 2:] / ray[..., 2:])
    textures = texture.expand(NUMBER, -1, -1, -1)
    images = F.grid_sample(textures, wall[..., :2] / 3, align_corners=False, padding_mode="reflection")
    return Views(images[None], seen, names=tuple(f"view_{view}" for view in range(NUMBER)))


def _run(plugin: Subject[Reconstruction], views: Views) -> Reconstructed:
    with seeded(0), torch.no_grad():
        return plugin.build()(views, ToyBackbone(dim=12, depth=2).freeze().encode, ToyRenderer())


@cache
def _once(plugin: Subject[Reconstruction]) -> Reconstructed:
    return _run(plugin, photographs())
