"""What the checks of backbones share: views, the scene they are encoded to, and what every scene must be."""

import torch

from anystyle.contracts import Backbone
from anystyle.testing.check import ContractError, attempt, expect
from anystyle.testing.comparing import conform, expect_finite
from anystyle.testing.inputs import views
from anystyle.testing.subject import Subject
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Scene, Tokens, Views

Plugin = Subject[Backbone]

SQUARE = (3, 3)
"""Height and width in patches of what most checks use."""


def frozen(plugin: Plugin) -> Backbone:
    """The shared instance, as the stylizer holds it."""
    return plugin.instance.freeze()


def some_views(plugin: Plugin, *, batch: int = 1, number: int = 2, shape: tuple[int, int] = SQUARE) -> Views:
    """Views of so many scenes, numbers of views and patches."""
    patch = plugin.instance.patch_size
    return views(batch, number, (shape[0] * patch, shape[1] * patch))


@torch.no_grad()
def encoded(plugin: Plugin, batch: int = 1) -> Scene:
    """The scene of :func:`some_views`, encoded once for all checks; none may change it."""
    return plugin.once(f"{batch} scenes", lambda: frozen(plugin).encode(some_views(plugin, batch=batch)))


def adapted(backbone: Backbone, scene: Scene) -> Gaussians:
    """A scene's own Gaussians."""
    return backbone.adapter(scene.attributes, scene.geometry, scene.clusters)


def expect_scene(plugin: Plugin, given: Views) -> None:
    """Hold all that ``encode`` gives, and the adapter's Gaussians, against the shapes their types declare."""
    batch, number, _, height, width = given.images.shape
    what = f"`encode` of {batch} scene(s), {number} view(s) of {height}x{width} pixels"
    with attempt(what, change="make it work for any number of scenes and views, and any multiple of the patch"):
        scene = frozen(plugin).encode(given)
    sizes = {"B": batch, "V": number}
    pixels = {**sizes, "H": height, "W": width}
    patch = plugin.instance.patch_size
    conform(scene.stem, Tokens, f"`embedder` in {what}", **sizes)
    expect_grid(scene.stem, "`embedder`", (height // patch, width // patch))
    expect(
        len(scene.features) > 0,
        given="no features",
        expected="the tokens that the heads read, by their layer",
        change="return them from `aggregator.forward`",
    )
    for layer, tokens in scene.features.items():
        conform(tokens, Tokens, f"`aggregator` at layer {layer} in {what}", **sizes)
        expect_grid(tokens, f"`aggregator` at layer {layer}", (height // patch, width // patch))
    conform(scene.geometry, Geometry, f"`geometry_head` in {what}", **pixels)
    conform(scene.geometry.cameras, Cameras, f"`geometry_head` in {what}", **sizes)
    conform(scene.attributes, Attributes, f"`gaussian_head` in {what}", **pixels)
    with attempt(f"`adapter` in {what}", change="make it work for any number of scenes, views and pixels"):
        gaussians = adapted(plugin.instance, scene)
    conform(gaussians, Gaussians, f"`adapter` in {what}", B=batch)
    expect(
        tuple(scene.cameras.size) == (height, width),
        given=f"cameras of size {tuple(scene.cameras.size)} in {what}",
        expected=f"({height}, {width}), height before width",
        change="pass `size` on as it comes",
    )


def expect_all_finite(backbone: Backbone, scene: Scene) -> None:
    """Refuse NaN and infinity anywhere in a scene and its Gaussians."""
    for name in ("stem", "features", "geometry", "attributes"):
        expect_finite(getattr(scene, name), f"`{name}`")
    expect_finite(adapted(backbone, scene), "the adapter's Gaussians")


def expect_finite_as_ever(plugin: Plugin, given: Views) -> None:
    """Refuse NaN and infinity in the scene of these views, if others have none."""
    # Numbers that are never finite are one finding, told by the check of their own.
    backbone = frozen(plugin)
    try:
        expect_all_finite(backbone, encoded(plugin))
    except ContractError:
        return
    expect_all_finite(backbone, backbone.encode(given))


def expect_grid(tokens: Tokens, where: str, grid: tuple[int, int] | None = None) -> None:
    """Hold the number of tokens against the grid, and the grid against what it should be."""
    rows, columns = tokens.grid
    count = tokens.data.shape[2]
    expect(
        count == tokens.special + rows * columns,
        given=f"{where} has {count} tokens a view, {tokens.special} special ones and a grid of {rows}x{columns}",
        expected="special tokens and one for each place of the grid",
        change="set `grid` and `special` of its Tokens",
    )
    expect(
        grid is None or tuple(tokens.grid) == grid,
        given=f"{where} has a grid of {rows}x{columns}",
        expected=f"{'x'.join(map(str, grid or ()))}, rows before columns",
        change="compute it from the images' height and width, divided by `patch_size`",
    )
