"""What a reconstruction promises: see :class:`anystyle.reconstructions.contract.Reconstruction`."""

from dataclasses import replace

import torch
import torch.nn.functional as F

from anystyle.reconstructions.contract import Reconstruction
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import conform, expect_close, expect_finite, expect_same
from anystyle.testing.inputs import cameras, generator
from anystyle.testing.subject import Subject, seeded
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.types import Attributes, Gaussians, Geometry, Reconstructed, Views

Plugin = Subject[Reconstruction]

SIZE, NUMBER = (48, 64), 4


def makes_a_scene_of_the_views(plugin: Plugin) -> None:
    """It gives cameras, depth and attributes of every view at its size, and Gaussians if the scene has its own."""
    scene = _once(plugin).scene
    sizes = {"B": 1, "V": NUMBER, "H": SIZE[0], "W": SIZE[1]}
    conform(scene.geometry, Geometry, "the scene's geometry", **sizes)
    conform(scene.attributes, Attributes, "the scene's attributes", **sizes)
    expect_finite(scene.geometry, "the scene's geometry")
    if scene.gaussians is not None:
        conform(scene.gaussians, Gaussians, "the scene's Gaussians", B=1)
        expect_finite(scene.gaussians, "the scene's Gaussians")
    expect(
        scene.views.size == SIZE and scene.views.images.shape[1] == NUMBER,
        given=f"{scene.views.images.shape[1]} views of {scene.views.size}",
        expected=f"those given: {NUMBER} of {SIZE}",
        change="keep the views, in their order",
    )


def origins_are_pixels_of_the_views(plugin: Plugin) -> None:
    """Where Gaussians come from pixels, each has one view, row and column, inside of the views."""
    scene = _once(plugin).scene
    if scene.origins is None:
        return
    count = -1 if scene.gaussians is None else scene.gaussians.means.shape[1]
    limits = torch.tensor([NUMBER, *SIZE])
    inside = bool(((scene.origins >= 0) & (scene.origins < limits)).all())
    expect(
        tuple(scene.origins.shape) == (1, count, 3) and not scene.origins.is_floating_point() and inside,
        given=f"origins of shape {list(scene.origins.shape)} and type {scene.origins.dtype} up to "
        f"{scene.origins.flatten(0, 1).amax(0).tolist()}, for {count} Gaussians",
        expected=f"integers [1, {count}, 3] under {limits.tolist()}",
        change="give view, row and column of the views as they were given, counted from 0",
    )


def keeps_cameras_that_are_known(plugin: Plugin) -> None:
    """The scene lies in the frame of the given cameras, where it needs them."""
    if not plugin.instance.needs_cameras:
        return
    expect_close(
        _once(plugin).scene.cameras,
        cameras(1, NUMBER, SIZE),
        what="the scene's cameras",
        change="put the views' cameras into the scene's geometry",
    )


def says_that_cameras_are_missing(plugin: Plugin) -> None:
    """Views without cameras raise a ValueError of one line, where it needs them."""
    if not plugin.instance.needs_cameras:
        return
    change = "set `needs_cameras = False` if it does without, or say in one line what is missing and what to do"
    with refusal(change, unless="a scene of views without cameras"):
        _run(plugin, replace(photographs(), cameras=None))


def leaves_the_views_alone(plugin: Plugin) -> None:
    """It writes into none of the tensors that it is given."""
    given = photographs()
    before = given.map(torch.clone)
    _run(plugin, given)
    expect_same(given, before, what="the views", change="write into copies")


def measures_are_finite(plugin: Plugin) -> None:
    """What it measured are finite numbers by name."""
    measures = _once(plugin).measures
    wrong = [
        name
        for name, value in measures.items()
        if not isinstance(value, (int, float)) or not torch.tensor(float(value)).isfinite()
    ]
    expect(
        not wrong, given=f"{', '.join(wrong)} that are no finite numbers", change="leave out what could not be measured"
    )


def gives_the_same_twice(plugin: Plugin) -> None:
    """A new instance makes the same scene of the same views."""
    expect_same(
        _run(plugin, photographs()).scene.gaussians or _once(plugin).scene.attributes,
        _once(plugin).scene.gaussians or _once(plugin).scene.attributes,
        what="what a second run gives",
        change="draw what is random from a generator with a seed of its own",
    )


def photographs() -> Views:
    """Photographs of a coloured wall in the plane z = 0, from cameras that are known."""
    seen = cameras(1, NUMBER, SIZE)
    texture = torch.rand(1, 3, 24, 24, generator=generator(11))
    unit = Geometry(seen, torch.ones(1, NUMBER, *SIZE), torch.ones(1, NUMBER, *SIZE)).points()[0]  # V H W 3
    center = seen.world_from_camera[0, :, None, None, :3, 3]
    ray = unit - center
    wall = center - ray * (center[..., 2:] / ray[..., 2:])
    images = F.grid_sample(
        texture.expand(NUMBER, -1, -1, -1), wall[..., :2] / 3, align_corners=False, padding_mode="reflection"
    )
    return Views(images[None], seen, names=tuple(f"view_{view}" for view in range(NUMBER)))


def _run(plugin: Plugin, views: Views) -> Reconstructed:
    with seeded(0), torch.no_grad():
        backbone = ToyBackbone(dim=12, depth=2).freeze()
        return plugin.build()(views, backbone.encode, ToyRenderer())


def _once(plugin: Plugin) -> Reconstructed:
    def make() -> Reconstructed:
        with attempt(f"a scene of {NUMBER} photographs", change="make it work on four small views with cameras"):
            return _run(plugin, photographs())

    return plugin.once("scene", make)


CHECKS = (
    Check(makes_a_scene_of_the_views, needed=True, see="ToyReconstruction"),
    Check(origins_are_pixels_of_the_views, see="ToyReconstruction"),
    Check(keeps_cameras_that_are_known, see="ToyReconstruction"),
    Check(says_that_cameras_are_missing, see="ToyReconstruction"),
    Check(leaves_the_views_alone),
    Check(measures_are_finite),
    Check(gives_the_same_twice),
)
