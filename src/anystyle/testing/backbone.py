"""What a backbone promises: see :class:`anystyle.contracts.Backbone`."""

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch import Tensor

from anystyle import contracts
from anystyle.contracts import Backbone, Published
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.pipeline.weights import load_reference
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import override
from anystyle.testing import asserts
from anystyle.testing.inputs import cameras, noise, views_of
from anystyle.testing.subject import Subject
from anystyle.types import Attributes, Cameras, Clusters, Gaussians, Geometry, Scene, Tokens, Views, untouched
from anystyle.types.shapes import check_value

PARTS = ("embedder", "aggregator", "geometry_head", "gaussian_head", "adapter")


def test_encodes_views(plugin: Subject[Backbone]) -> None:
    """It has five parts and the reader of checkpoints that it names, and encodes any number of views, square or not."""
    for name in PARTS:
        base = getattr(contracts, name.title().replace("_", ""))
        part = getattr(plugin.instance, name, None)
        assert isinstance(part, base), f"`{name}` is a {type(part).__name__}, not an anystyle.contracts.{base.__name__}"
    for name in ("patch_size", "resolution"):
        value = getattr(plugin.instance, name, None)
        assert isinstance(value, int) and value >= 1, f"`{name}` is {value!r}, not a number of pixels"
    published = plugin.instance.checkpoints()
    assert published is None or isinstance(published, Published), f"`published` is a {type(published).__name__}"
    for number, shape in ((2, (3, 3)), (1, (3, 3)), (2, (2, 3)), (2, (5, 4))):
        _assert_encodes(plugin, _views(plugin, number=number, shape=shape))


@torch.no_grad()
def test_encodes_several_scenes_at_once(plugin: Subject[Backbone]) -> None:
    """A batch of scenes gives what each scene gives alone."""
    together = _views(plugin, batch=2)
    _assert_encodes(plugin, together)
    backbone, both = plugin.instance.freeze(), _scene(plugin, batch=2)
    for index in range(2):
        alone = backbone.encode(together.row(index))
        for name in ("stem", "features", "geometry", "attributes"):
            value = getattr(both, name)
            mine = {key: value[key].row(index) for key in value} if name == "features" else value.row(index)
            what = f"`{name}` of scene {index} of a batch of two against the same scene alone"
            asserts.close(mine, getattr(alone, name), what)


@torch.no_grad()
def test_numbers_are_finite(plugin: Subject[Backbone]) -> None:
    """Nothing is NaN or infinite, not for black or white images either."""
    views = _views(plugin)
    for given in (views.images, torch.zeros_like(views.images), torch.ones_like(views.images)):
        scene = plugin.instance.freeze().encode(replace(views, images=given))
        asserts.finite((scene, _gaussians(plugin.instance, scene)), "the encoded scene")


def test_cameras_are_rigid_pinholes(plugin: Subject[Backbone]) -> None:
    """Poses are rotations and translations, focal lengths positive, and the confidence of the depth at least 0."""
    for shape in ((2, 5), (5, 2)):
        geometry = _scene(plugin, shape=shape).geometry
        asserts.cameras(geometry.cameras, _views(plugin, shape=shape).size)
        lowest = float(geometry.confidence.min())
        assert lowest >= 0, f"a confidence of {lowest:.3g}"


@torch.no_grad()
def test_needed_cameras_are_those_of_the_scene(plugin: Subject[Backbone]) -> None:
    """A backbone that needs cameras gives the scene those of its views; views without any raise a UserError."""
    if not plugin.instance.needs_cameras:
        return
    asserts.close(_scene(plugin).cameras, _views(plugin).cameras, "the scene's cameras")
    _assert_refused(plugin.instance.freeze().encode, replace(_views(plugin), cameras=None))


@torch.no_grad()
def test_patches_keep_their_places(plugin: Subject[Backbone]) -> None:
    """Another patch in a photograph changes tokens, depth and Gaussians there most: views apart, patches row by row."""
    views, patch, shape = _views(plugin, shape=(2, 5)), plugin.instance.patch_size, (2, 2, 5)
    every = torch.eye(20).view(20, 2, 1, 2, 5).repeat_interleave(patch, dim=3).repeat_interleave(patch, dim=4)
    others = replace(views.expand(20), images=views.images + every * (1 - 2 * views.images))
    before, after = _maps(_scene(plugin, shape=(2, 5))), _maps(plugin.instance.encode(others))
    for name, value in before.items():
        change = (after[name] - value).abs()
        change = change.reshape(*change.shape[:4], -1).sum(-1)  # 20 V h w
        if not bool(change.sum((1, 2, 3)).all()):
            continue
        for what, axis in (("view", 1), ("column", 3)):
            share = change.sum([each for each in (1, 2, 3) if each != axis])
            center = (share * torch.linspace(0, 1, share.shape[1])).sum(1) / share.sum(1)
            place = torch.cartesian_prod(*map(torch.arange, shape))[:, axis - 1]
            follows = float(torch.corrcoef(torch.stack([center, place]))[0, 1])
            assert follows > 0.7, f"{name} does not change at the {what} of a patch that changes (r = {follows:.2f})"


@torch.no_grad()
def test_gaussians_lie_where_pixels_see_them(plugin: Subject[Backbone]) -> None:
    """In any cameras a Gaussian that is not moved by an offset lies in its pixel, as far away as the geometry says."""
    views, adapter = _views(plugin, shape=(2, 5)), plugin.instance.adapter
    scene, eyes = _scene(plugin, shape=(2, 5)), torch.tensor([[[2.0, -1.0, -3.0], [-1.0, 2.0, -2.0]]])
    lenses = cameras(1, 2, views.size).intrinsics * torch.tensor([[1.0, 1.0, 0.8], [1.0, 1.5, 1.3], [1.0, 1.0, 1.0]])
    seen = Cameras(look_at(eyes, torch.zeros_like(eyes)), lenses, views.size)
    depth = torch.tensor([2.0, 4.0])[None, :, None, None].expand_as(scene.geometry.depth)
    geometry = replace(scene.geometry, depth=depth).seen_from(seen)
    offset = None if scene.attributes.offset is None else torch.zeros_like(scene.attributes.offset)
    attributes = replace(scene.attributes, offset=offset)
    clusters = adapter.cluster(geometry, attributes)
    means = adapter(attributes, geometry, clusters).means[0]
    means = means if clusters is None else means[clusters.index[0]]
    motion = seen.camera_from_world[0, :, None]
    points = torch.stack([means.unflatten(0, (2, -1)), geometry.points()[0].flatten(1, 2)])  # 2 V M 3
    local = (motion[..., :3, :3] @ points[..., None])[..., 0] + motion[..., :3, 3]
    pixel = (lenses[0, :, None] @ local[..., None])[..., :2, 0] / local[..., 2:]
    away = float((pixel[0] - pixel[1]).norm(dim=-1).median())
    assert away < 0.9, f"Gaussians are {away:.1f} pixels from the pixels of `geometry.points()`, in known cameras"
    ratio = float((local[0, ..., 2] / local[1, ..., 2]).median())
    assert 0.8 < ratio < 1.25, f"Gaussians are {ratio:.2f} times as far away along z as `geometry.points()`"


def test_gaussians_are_renderable(plugin: Subject[Backbone]) -> None:
    """Opacities lie in [0, 1], scales are at least 0, and a padded Gaussian is transparent."""
    scene = _scene(plugin, batch=2)
    gaussians, clusters = _gaussians(plugin.instance, scene), scene.clusters
    low, high = float(gaussians.opacities.min()), float(gaussians.opacities.max())
    assert low >= 0 and high <= 1, f"opacities from {low:.3g} to {high:.3g}; pass the logits through a sigmoid"
    assert bool((gaussians.scales >= 0).all()), "negative scales; pass them through an exponential or a softplus"
    if clusters is not None:
        check_value(clusters, Clusters, "`adapter.cluster`", B=2, M=_views(plugin).images[:, :, 0].numel())
        assert bool((clusters.index < clusters.means.shape[1]).all()), "`clusters.index` of Gaussians that do not exist"
        assert not bool(gaussians.opacities[~clusters.valid].any()), "padded Gaussians that are not transparent"


@torch.no_grad()
def test_every_site_is_visited(plugin: Subject[Backbone]) -> None:
    """Every site, and no other, is passed to ``inject``, in the order of ``sites``, with the declared channels."""
    backbone, given = plugin.instance.freeze(), _views(plugin)
    visited: dict[str, Tokens] = {}
    record = lambda site, tokens: visited.setdefault(site, tokens)  # noqa: E731
    features = backbone.aggregator(backbone.stem_of(given), record)
    in_aggregator = list(visited)
    backbone.gaussian_head(features, given.images, record)
    sites = {site.name: site for site in backbone.sites}
    assert list(visited) == list(sites) != [], f"`inject` is called at {list(visited)}, `sites` are {list(sites)}"
    for name, tokens in visited.items():
        prefix = "aggregator/" if name in in_aggregator else "head/"
        assert name.startswith(prefix) and "." not in name, f"site {name!r} should begin with {prefix!r}, without '.'"
        _assert_tokens(tokens, f"`inject` at {name}", V=2, C=sites[name].dim)


@torch.no_grad()
def test_injected_tokens_are_used(plugin: Subject[Backbone]) -> None:
    """The network goes on with the tokens that ``inject`` returns: the same bits if they are the same."""
    backbone, scene = plugin.instance.freeze(), _scene(plugin)
    _assert_same_parts(backbone.aggregator, backbone.gaussian_head, scene, "without injection")
    for site in backbone.sites:

        def add_noise(name: str, tokens: Tokens, chosen: str = site.name) -> Tokens:
            added = noise(tokens.data) * (1 + tokens.data.std()) if name == chosen else torch.zeros(())
            return tokens.with_data(tokens.data + added)

        if site.name.startswith("aggregator/"):
            before, after = scene.features, backbone.aggregator(scene.stem, add_noise)
        else:
            before, after = scene.attributes, backbone.gaussian_head(scene.features, scene.views.images, add_noise)
        ours, theirs = asserts.tensors_of(after), asserts.tensors_of(before)
        changed = any(not torch.equal(ours[name], theirs[name]) for name in theirs)
        assert changed, f"other tokens at {site.name} change nothing; use `tokens = inject({site.name!r}, tokens)`"


@torch.no_grad()
def test_colors_may_be_left_out(plugin: Subject[Backbone]) -> None:
    """Without colours all else of a scene has the same bits."""
    backbone, whole = plugin.instance.freeze(), _scene(plugin)
    scene = backbone.encode(_views(plugin), colors=False)
    assert scene.attributes.color.shape == whole.attributes.color.shape, (
        "`without_colors` gives colours of another shape"
    )
    attributes = replace(scene.attributes, color=whole.attributes.color)
    asserts.same(replace(scene, attributes=attributes), whole, "a scene without colours")


@torch.no_grad()
def test_encoding_twice_is_the_same(plugin: Subject[Backbone]) -> None:
    """The same views give the same scene, bit for bit, and are left as they were."""
    backbone, given = plugin.instance.freeze(), _views(plugin)
    first = backbone.encode(given).map(Tensor.clone)
    asserts.same(given, _views(plugin), "the views after `encode`")
    asserts.same(backbone.encode(given), first, "the second scene")


@torch.no_grad()
def test_copies_compute_the_same(plugin: Subject[Backbone]) -> None:
    """Deep copies of the aggregator and of the Gaussian head give the same bits, on weights of their own."""
    backbone, scene = plugin.instance.freeze(), _scene(plugin)
    aggregator, head = copy.deepcopy(backbone.aggregator), copy.deepcopy(backbone.gaussian_head)
    _assert_same_parts(aggregator, head, scene, "of a copy")
    for parameter in (*aggregator.parameters(), *head.parameters()):
        parameter.add_(1.0)
    _assert_same_parts(backbone.aggregator, backbone.gaussian_head, scene, "after the copy learned")


def test_frozen_for_good(plugin: Subject[Backbone]) -> None:
    """After ``freeze`` nothing learns, and every module stays in ``eval`` mode."""
    backbone = plugin.build().freeze().train()
    active = [name for name, module in backbone.named_modules() if module.training]
    active += [name for name, parameter in backbone.named_parameters() if parameter.requires_grad]
    assert not active, f"after `freeze()` and `train()`, still in training mode or learning: {active[:3]}"


def test_attributes_carry_gradients(plugin: Subject[Backbone]) -> None:
    """The adapter is differentiable in opacity, scale, rotation and colour."""
    scene = _scene(plugin)
    leaves: Attributes = scene.attributes.map(lambda tensor: tensor.clone().requires_grad_())
    gaussians = plugin.instance.adapter(leaves, scene.geometry, scene.clusters)
    outputs = [tensor for tensor in vars(gaussians).values() if tensor.requires_grad]
    torch.autograd.backward(outputs, [noise(tensor, seed) for seed, tensor in enumerate(outputs)])
    for name in ("opacity", "scale", "rotation", "color"):
        asserts.gradient(getattr(leaves, name).grad, f"`attributes.{name}`")


@torch.no_grad()
def test_published_weights_load_strictly(plugin: Subject[Backbone]) -> None:
    """A file in the published layout gives every tensor; one that differs is refused in one line and changes none."""
    if (published := plugin.instance.checkpoints()) is None:
        return
    file, backbone = _published_file(plugin, published), plugin.build(seed=1)
    name, tensor = next(iter(file.items()))
    published.load("backbone", backbone, file)
    asserts.same(backbone.state_dict(), plugin.instance.state_dict(), "weights that were loaded")
    assert published.parts(file).get("backbone") is True, "`parts` does not say that the file has the whole backbone"
    _assert_refused(published.load, "backbone", backbone, {key: file[key] for key in file if key != name})
    _assert_refused(published.load, "backbone", backbone, file | {f"{name}.more": tensor})
    _assert_refused(published.load, "backbone", backbone, file | {name: torch.cat([tensor, tensor])})
    for other in ({}, {"of.another.network": tensor}):
        _assert_refused(published.load, "backbone", backbone, other)
        _assert_refused(published.config, other)
        _assert_refused(published.parts, other)
    asserts.same(backbone.state_dict(), plugin.instance.state_dict(), "weights after files that were refused")


@torch.no_grad()
def test_a_published_file_becomes_a_stylizer(plugin: Subject[Backbone]) -> None:
    """Options that are read off its shapes build a network that it fits, and one call a stylizer of its weights."""
    if (published := plugin.instance.checkpoints()) is None:
        return
    file, own = _published_file(plugin, published), plugin.instance.state_dict()
    found = published.config(file)
    options = {key.removeprefix("backbone."): value for key, value in found.items() if key.startswith("backbone.")}
    assert options, "`config` reads no option of the backbone off the shapes"
    state = plugin.cls(**(dict(plugin.options) | options)).state_dict()
    shapes, expected = ({key: list(tensor.shape) for key, tensor in each.items()} for each in (state, own))
    assert shapes == expected, f"`config` reads {options} off the shapes of a network of other shapes"
    name = catalog().name_of("backbone", plugin.cls)
    if name not in catalog().names("backbone"):
        return
    rest = [override(f"backbone.{key}", value) for key, value in plugin.options.items() if key not in options]
    stylizer = load_reference(file, overrides=[f"backbone={name}", *rest])
    asserts.same(stylizer.backbone.state_dict(), own, "weights of a stylizer made of a file")
    asserts.finite(stylizer.unstyled(stylizer.encode(_views(plugin))), "Gaussians of a stylizer made of a file")


def _published_file(plugin: Subject[Backbone], published: Published) -> dict[str, Tensor]:
    own = plugin.instance.state_dict()
    names = published.names(own)
    assert names.keys() == own.keys(), "`names` leaves out keys of the state dict, or adds some"
    assert len(set(names.values())) == len(names), "`names` gives two tensors one name"
    return {names[key]: tensor.clone() for key, tensor in own.items()}


def _assert_refused(function: Callable[..., object], *given: object) -> None:
    with pytest.raises(UserError, match=asserts.ONE_LINE):
        function(*given)


def _views(plugin: Subject[Backbone], *, batch: int = 1, number: int = 2, shape: tuple[int, int] = (3, 3)) -> Views:
    """Views of ``batch`` scenes; ``shape`` is height and width in patches."""
    return views_of(plugin.instance, batch, number, shape)


@cache
@torch.no_grad()
def _scene(plugin: Subject[Backbone], batch: int = 1, shape: tuple[int, int] = (3, 3)) -> Scene:
    return plugin.instance.freeze().encode(_views(plugin, batch=batch, shape=shape))


def _maps(scene: Scene) -> dict[str, Tensor]:
    """All that a backbone says of places in views, as maps of patches or pixels ``[B, V, h, w, ...]``."""
    tokens = {"the stem": scene.stem} | {f"layer {layer}": each for layer, each in scene.features.items()}
    depth = scene.geometry.depth if scene.geometry.pointmap is None else scene.geometry.pointmap
    maps = {name: each.patches.unflatten(2, each.grid) for name, each in tokens.items()}
    return maps | {"depth": depth} | asserts.tensors_of(scene.attributes)


def _gaussians(backbone: Backbone, scene: Scene) -> Gaussians:
    return backbone.adapter(scene.attributes, scene.geometry, scene.clusters)


@torch.no_grad()
def _assert_encodes(plugin: Subject[Backbone], given: Views) -> None:
    """Hold all that ``encode`` returns, and the adapter's Gaussians, against the shapes their types declare."""
    backbone = plugin.instance.freeze()
    batch, number, _, height, width = given.images.shape
    scene = backbone.encode(given)
    sizes, patch = {"B": batch, "V": number}, backbone.patch_size
    for tokens in (scene.stem, *scene.features.values()):
        _assert_tokens(tokens, "`embedder` or `aggregator`", **sizes)
        assert tokens.grid == (height // patch, width // patch), f"a grid {tokens.grid} of {height}x{width} pixels"
    check_value(scene.geometry, Geometry, "`geometry_head`", **sizes, H=height, W=width)
    check_value(scene.geometry.cameras, Cameras, "`geometry_head`", **sizes)
    check_value(scene.attributes, Attributes, "`gaussian_head`", **sizes, H=height, W=width)
    check_value(_gaussians(backbone, scene), Gaussians, "`adapter`", B=batch)
    for name, tensor in asserts.tensors_of((scene.geometry, scene.attributes)).items():
        assert tensor.dtype == torch.float32, f"`{name}` is {tensor.dtype}; end the head with `.float()`"


def _assert_same_parts(aggregator: contracts.Aggregator, head: contracts.GaussianHead, scene: Scene, what: str) -> None:
    asserts.same(aggregator(scene.stem, untouched), scene.features, f"features {what}")
    asserts.same(head(scene.features, scene.views.images, untouched), scene.attributes, f"attributes {what}")


def _assert_tokens(tokens: Tokens, where: str, **sizes: int) -> None:
    check_value(tokens, Tokens, where, **sizes)
    rows, columns = tokens.grid
    count = tokens.special + rows * columns
    assert tokens.data.shape[2] == count, f"{where}: {tokens.data.shape[2]} tokens, not {count} by `special` and `grid`"
