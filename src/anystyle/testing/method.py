"""What a method promises: see :class:`anystyle.methods.contract.Method`."""

from collections.abc import Callable

import torch
from torch import Tensor

from anystyle.branch import COLOR, StyleBranch, sites_of
from anystyle.methods.contract import Method, Progress, silent
from anystyle.stylizer import Stylizer
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import conform, expect_finite, expect_same
from anystyle.testing.inputs import images, views
from anystyle.testing.subject import Subject, seeded
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.renderer import ToyRenderer
from anystyle.testing.toy.style_encoder import ToyStyleEncoder
from anystyle.types import Gaussians, Scene, Style

Plugin = Subject[Method]

SIZE, NUMBER = (16, 24), 2


def gives_gaussians(plugin: Plugin) -> None:
    """It gives finite Gaussians of one scene, free of gradients, which can be rendered."""
    gaussians = _once(plugin)
    conform(gaussians, Gaussians, "the stylized Gaussians", B=1)
    expect_finite(gaussians, "the stylized Gaussians")
    expect(
        not any(tensor.requires_grad for tensor in vars(gaussians).values()),
        given="Gaussians that take gradients",
        change="return `gaussians.detach()`",
    )
    stylizer, scene = _world()
    expect_finite(stylizer.render(gaussians, scene.cameras), "renders of the stylized Gaussians")


def leaves_the_scene_alone(plugin: Plugin) -> None:
    """The scene and the stylizer's weights are what they were: the next style begins with them."""
    stylizer, scene = _world()
    before, weights = scene.map(torch.clone), {name: value.clone() for name, value in stylizer.state_dict().items()}
    _run(plugin, stylizer, scene)
    expect_same(scene, before, what="the scene", change="write into copies")
    for name, value in stylizer.state_dict().items():
        expect_same(value, weights[name], what=f"`{name}` of the stylizer", change="copy it")


def gives_the_same_twice(plugin: Plugin) -> None:
    """A new instance gives the same for the same scene and style."""
    expect_same(
        _run(plugin, *_world()),
        _once(plugin),
        what="what a second run gives",
        change="draw what is random from a generator with a seed of its own",
    )


def works_where_gradients_are_off(plugin: Plugin) -> None:
    """Callers compute without gradients; a method that needs them turns them on itself."""
    with torch.no_grad(), attempt("a method called under `torch.no_grad()`", change="use `torch.enable_grad()` inside"):
        _run(plugin, *_world())


def says_in_a_line_that_a_style_lacks_something(plugin: Plugin) -> None:
    """A style that is a text alone, or nothing but an embedding, gives Gaussians or a ValueError of one line."""
    stylizer, scene = _world()
    for style in (Style(text=("deep blue",)), Style()):
        with refusal("say in a line what is missing"):
            _run(plugin, stylizer, scene, style)


def progress_can_be_shown(plugin: Plugin) -> None:
    """Every report is one line, and a picture in [0, 1] where there is one."""
    reports: list[Progress] = []
    _run(plugin, *_world(), on_progress=reports.append)
    for report in reports:
        expect(
            len(report.line.splitlines()) == 1,
            given=f"a report of {len(report.line.splitlines())} lines",
            change="say in a line where the method is",
        )
        if report.thumbnail is not None:
            _check_thumbnail(report.thumbnail)


def _check_thumbnail(thumbnail: Tensor) -> None:
    expect(
        thumbnail.ndim == 3 and thumbnail.shape[0] == 3 and 0 <= float(thumbnail.min()) <= float(thumbnail.max()) <= 1,
        given=f"a thumbnail of shape {list(thumbnail.shape)} with values up to {float(thumbnail.max()):.3g}",
        expected="[3, height, width] in [0, 1]",
        change="give one sRGB picture",
    )


def _world() -> tuple[Stylizer, Scene]:
    """A toy stylizer whose branch styles colours, and a scene."""
    with seeded(0):
        backbone = ToyBackbone(dim=12, depth=2).freeze()
        encoder = ToyStyleEncoder()
        sites = [site for site in sites_of(backbone) if site.name == COLOR]
        branch = StyleBranch(
            backbone, sites=sites, make_injector=lambda site: ToyInjector(dim=site.dim, style_dim=encoder.dim)
        )
        stylizer = Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=ToyRenderer())
        stylizer.requires_grad_(False).eval()
        return stylizer, stylizer.encode(views(1, NUMBER, SIZE))


def _run(
    plugin: Plugin,
    stylizer: Stylizer,
    scene: Scene,
    style: Style | None = None,
    on_progress: Callable[[Progress], None] = silent,
) -> Gaussians:
    given = style or Style(image=images(1, (48, 40), seed=50))
    embedding = stylizer.embed(text="deep blue") if given.image is None else stylizer.embed(image=given.image)
    return plugin.build()(stylizer, scene, given, embedding, on_progress=on_progress)


def _once(plugin: Plugin) -> Gaussians:
    def make() -> Gaussians:
        with attempt(f"a scene of {NUMBER} views and an image", change="make it work on a small scene"):
            return _run(plugin, *_world())

    return plugin.once("gaussians", make)


CHECKS = (
    Check(gives_gaussians, needed=True, see="ToyMethod"),
    Check(leaves_the_scene_alone),
    Check(gives_the_same_twice),
    Check(works_where_gradients_are_off),
    Check(says_in_a_line_that_a_style_lacks_something),
    Check(progress_can_be_shown),
)
