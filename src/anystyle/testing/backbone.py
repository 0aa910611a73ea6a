"""What a backbone promises: see :class:`anystyle.contracts.Backbone`."""

from dataclasses import replace

import torch
from torch import Tensor

from anystyle.contracts import Adapter, Aggregator, Backbone, Embedder, GaussianHead, GeometryHead
from anystyle.testing.check import Check, ContractError, attempt, expect
from anystyle.testing.comparing import conform, expect_close, expect_finite, expect_same, kind_and_shape, tensors_of
from anystyle.testing.inputs import generator, views
from anystyle.testing.subject import Subject
from anystyle.types import (
    Attributes,
    Cameras,
    Clusters,
    Features,
    Gaussians,
    Geometry,
    Scene,
    Site,
    Tokens,
    Value,
    Views,
    untouched,
)

PARTS = {
    "embedder": Embedder,
    "aggregator": Aggregator,
    "geometry_head": GeometryHead,
    "gaussian_head": GaussianHead,
    "adapter": Adapter,
}
SQUARE = (3, 3)
SHAPES = ((2, 3), (3, 2), (5, 4))
"""Heights and widths in patches: what most checks use, and what else must work."""

Plugin = Subject[Backbone]


def all_five_parts_are_there(plugin: Plugin) -> None:
    """The constructor sets the five parts, ``patch_size`` and ``resolution``."""
    backbone = plugin.instance
    for name, base in PARTS.items():
        part = getattr(backbone, name, None)
        expect(
            isinstance(part, base),
            given=f"`{name}` is {'not set' if part is None else f'of class {type(part).__name__}'}",
            expected=f"a part that inherits from anystyle.contracts.{base.__name__}",
            change=f"set `self.{name}` in the constructor",
        )
    for name in ("patch_size", "resolution"):
        value = getattr(backbone, name, None)
        expect(
            isinstance(value, int) and value >= 1,
            given=f"`{name}` is {value!r}",
            expected="a number of pixels, at least 1",
            change=f"set `self.{name}` in the constructor",
        )


def final_methods_are_left_alone(plugin: Plugin) -> None:
    """``encode``, ``freeze``, ``train`` and ``sites`` are the framework's."""
    for name in ("encode", "freeze", "train", "sites"):
        owner = next(cls for cls in plugin.cls.__mro__ if name in vars(cls))
        expect(
            owner is Backbone,
            given=f"{owner.__name__} overrides `{name}`",
            expected="the method of anystyle.contracts.Backbone",
            change="move the work into one of the five parts",
        )


def sites_are_named_after_their_part(plugin: Plugin) -> None:
    """Sites are called ``aggregator/...`` or ``head/...``, once each, with the channels of their tokens."""
    backbone = plugin.instance
    found: list[str] = []
    for prefix, sites in (("aggregator/", backbone.aggregator.sites), ("head/", backbone.gaussian_head.sites)):
        for site in sites:
            expect(
                isinstance(site, Site) and site.name.startswith(prefix) and len(site.name) > len(prefix),
                given=f"a site {site!r}",
                expected=f"a Site whose name starts with {prefix!r} and goes on",
                change="rename it; the first word tells placements which part it is in",
            )
            expect(
                "." not in site.name and site.dim >= 1,
                given=f"a site {site.name!r} of {site.dim} channels",
                expected="a name without '.', and at least 1 channel",
                change="use '/' between the words of the name: it becomes a key of the state dict",
            )
            expect(
                site.name not in found,
                given=f"two sites named {site.name!r}",
                expected="every name once",
                change="number them, such as 'aggregator/4'",
            )
            found.append(site.name)
    expect(
        bool(found),
        given="no site at all",
        expected="at least one place where style may enter",
        change="list it in `sites` and call `inject(name, tokens)` there",
    )


@torch.no_grad()
def encodes_two_views(plugin: Plugin) -> None:
    """``encode`` works on two square views of one scene, and every tensor has the shape that its type declares."""
    _expect_scene(plugin, _views(plugin))


@torch.no_grad()
def encodes_a_single_view(plugin: Plugin) -> None:
    """``encode`` works on one view."""
    given = _views(plugin, number=1)
    _expect_scene(plugin, given)
    _expect_finite_as_ever(plugin, given)


@torch.no_grad()
def encodes_every_shape(plugin: Plugin) -> None:
    """``encode`` works on images that are not square, and on any multiple of the patch."""
    for shape in SHAPES:
        given = _views(plugin, shape=shape)
        _expect_scene(plugin, given)
        _expect_finite_as_ever(plugin, given)


@torch.no_grad()
def encodes_several_scenes_at_once(plugin: Plugin) -> None:
    """A batch of scenes gives what each scene gives alone."""
    together = _views(plugin, batch=2)
    _expect_scene(plugin, together)
    backbone, both = _frozen(plugin), _scene(plugin, batch=2)
    for index in range(2):
        alone = backbone.encode(together.map(lambda tensor, i=index: tensor[i : i + 1]))
        for name in ("stem", "features", "geometry", "attributes"):
            expect_close(
                _one_scene(getattr(both, name), index),
                getattr(alone, name),
                what=f"`{name}` of scene {index} of a batch of two against the same scene alone",
                expected="equal numbers, but for rounding",
                change="look for a sum, mean, reshape or normalisation that runs over axis 0",
            )
    _expect_fusion_by_scene(backbone, both)


@torch.no_grad()
def dtypes_are_kept(plugin: Plugin) -> None:
    """From float32 images come float32 tensors."""
    scene = _scene(plugin)
    for part in ("geometry", "attributes"):
        for name, tensor in tensors_of(getattr(scene, part)).items():
            expect(
                tensor.dtype == torch.float32,
                given=f"`{part}.{name}` is {kind_and_shape(tensor)}",
                expected="float32",
                change="convert at the end of the head, with `.float()`, or make the numpy arrays it uses float32",
            )


@torch.no_grad()
def numbers_are_finite(plugin: Plugin) -> None:
    """Nothing is NaN or infinite, not for black or white images either."""
    backbone = _frozen(plugin)
    images = _views(plugin).images
    flat = [Views(images=torch.full_like(images, value)) for value in (0.0, 1.0)]
    for scene in (_scene(plugin), *(backbone.encode(given) for given in flat)):
        _expect_finite(backbone, scene)


@torch.no_grad()
def cameras_are_rigid_pinholes(plugin: Plugin) -> None:
    """Poses are rotations and translations; focal lengths are positive; the size is that of the images."""
    expect_cameras(_scene(plugin).cameras, _views(plugin).size)


@torch.no_grad()
def confidence_is_not_negative(plugin: Plugin) -> None:
    """The confidence of the depth is at least 0."""
    lowest = float(_scene(plugin).geometry.confidence.min())
    expect(
        not lowest < 0,  # NaN is told elsewhere
        given=f"a confidence of {lowest:.3g}",
        expected="at least 0",
        change="end it with an exponential, a sigmoid or a softplus",
    )


@torch.no_grad()
def pixels_share_gaussians_fairly(plugin: Plugin) -> None:
    """Clusters give each pixel a Gaussian that exists, and the weights of a Gaussian's pixels sum to at most 1."""
    given = _views(plugin, batch=2)
    clusters = _scene(plugin, batch=2).clusters
    if clusters is None:
        return
    pixels = given.images.shape[1] * given.size[0] * given.size[1]
    conform(clusters, Clusters, "`adapter.cluster`", B=2, M=pixels)
    count = clusters.means.shape[1]
    low, high = int(clusters.index.min()), int(clusters.index.max())
    expect(
        low >= 0 and high < count,
        given=f"`clusters.index` from {low} to {high}",
        expected=f"from 0 to {count - 1}, for there are {count} means",
        change="give a pixel that is left out any valid index, and weight 0",
    )
    shares = torch.zeros(2, count).scatter_add(1, clusters.index.long(), clusters.weight.float())
    expect(
        float(clusters.weight.min()) >= 0 and float(shares.max()) <= 1 + 1e-3,
        given=f"weights from {float(clusters.weight.min()):.3g} that sum to up to {float(shares.max()):.4g}",
        expected="weights of at least 0 whose sum over a Gaussian's pixels is at most 1",
        change="normalise them over each cluster",
    )
    stray = int(((shares > 0) & ~clusters.valid).sum())
    expect(
        stray == 0 and bool(clusters.valid.any(1).all()),
        given=f"{stray} padded Gaussians that have pixels, and {clusters.valid.sum(1).tolist()} valid ones a scene",
        expected="pixels for valid Gaussians only, and some in every scene",
        change="compute `valid` from the number of clusters of each scene",
    )


@torch.no_grad()
def gaussians_are_renderable(plugin: Plugin) -> None:
    """Opacities lie in [0, 1], scales are at least 0, and a padded Gaussian is transparent."""
    backbone = _frozen(plugin)
    given = _views(plugin, batch=2)
    scene = _scene(plugin, batch=2)
    gaussians = _gaussians(backbone, scene)
    pixels = given.images.shape[1] * given.size[0] * given.size[1]
    count = pixels if scene.clusters is None else scene.clusters.means.shape[1]
    conform(gaussians, Gaussians, "`adapter`", B=2, N=count)
    low, high = float(gaussians.opacities.min()), float(gaussians.opacities.max())
    expect(
        not (low < 0 or high > 1),
        given=f"opacities from {low:.3g} to {high:.3g}",
        expected="within [0, 1]",
        change="pass the logits through a sigmoid in the adapter",
    )
    smallest = float(gaussians.scales.min())
    expect(
        not smallest < 0,
        given=f"a scale of {smallest:.3g}",
        expected="standard deviations, at least 0",
        change="pass scales through an exponential, a sigmoid or a softplus in the adapter",
    )
    if scene.clusters is not None and not bool(scene.clusters.valid.all()):
        padded = float(gaussians.opacities[~scene.clusters.valid].max())
        expect(
            padded == 0,
            given=f"a padded Gaussian of opacity {padded:.3g}",
            expected="0",
            change="multiply the opacities by `clusters.valid`",
        )


@torch.no_grad()
def every_site_is_visited(plugin: Plugin) -> None:
    """Every site, and no other, is passed to ``inject``, in the order of ``sites``, with the promised channels."""
    backbone, given = _frozen(plugin), _views(plugin)
    visited: dict[str, Tokens] = {}

    def record(site: str, tokens: Tokens) -> Tokens:
        visited.setdefault(site, tokens)
        return tokens

    features = backbone.aggregator(backbone.embedder(given.images), record)
    backbone.gaussian_head(features, given.images, record)
    expect(
        list(visited) == [site.name for site in backbone.sites],
        given=f"`inject` was called at {', '.join(visited) or 'no site'}",
        expected=f"calls at {', '.join(site.name for site in backbone.sites)}, in this order",
        change="make `sites` and the calls of `inject` agree",
    )
    for site in backbone.sites:
        where = f"`inject` at {site.name}"
        conform(visited[site.name], Tokens, where, B=1, V=2, C=site.dim)
        _expect_grid(visited[site.name], where)


@torch.no_grad()
def injected_tokens_are_used(plugin: Plugin) -> None:
    """What ``inject`` returns at a site is what the network goes on with."""
    backbone = _frozen(plugin)
    scene = _scene(plugin)
    images = scene.views.images
    for site in backbone.sites:

        def shake(name: str, tokens: Tokens, chosen: str = site.name) -> Tokens:
            if name != chosen:
                return tokens
            noise = torch.randn(tokens.data.shape, generator=generator(1)).to(tokens.data)
            return replace(tokens, data=tokens.data + noise * (1 + tokens.data.std()))

        in_aggregator = site.name.startswith("aggregator/")
        if in_aggregator:
            plain, shaken = scene.features, backbone.aggregator(scene.stem, shake)
        else:
            plain, shaken = scene.attributes, backbone.gaussian_head(scene.features, images, shake)
        ours, theirs = tensors_of(shaken), tensors_of(plain)
        expect(
            any(not torch.equal(ours[name], theirs[name]) for name in theirs),
            given=f"other tokens at {site.name} change nothing in the {'features' if in_aggregator else 'attributes'}",
            expected="a change",
            change=f"go on with what is returned: `tokens = inject({site.name!r}, tokens)`",
        )


@torch.no_grad()
def untouched_sites_change_nothing(plugin: Plugin) -> None:
    """With an ``inject`` that returns its tokens, features and attributes are the same bit for bit."""
    backbone = _frozen(plugin)
    scene = _scene(plugin)
    expected, change = "the same bits as without `inject`", "do nothing else where `inject` is called"
    for inject in (untouched, lambda site, tokens: replace(tokens, data=tokens.data.clone())):
        features = backbone.aggregator(scene.stem, inject)
        expect_same(features, scene.features, what="features", expected=expected, change=change)
        attributes = backbone.gaussian_head(scene.features, scene.views.images, inject)
        expect_same(attributes, scene.attributes, what="attributes", expected=expected, change=change)


@torch.no_grad()
def encoding_twice_is_the_same(plugin: Plugin) -> None:
    """The same views give the same scene, bit for bit, and are left as they were."""
    backbone = _frozen(plugin)
    given = _views(plugin)
    before = given.images.clone()
    first = backbone.encode(given)
    expect_same(
        given.images,
        before,
        what="the images after `encode`",
        expected="unchanged images",
        change="replace operations that end in '_', or write into a slice, by ones that make a new tensor",
    )
    kept = first.map(Tensor.clone)
    again = backbone.encode(given)
    for what, scene in (("the second scene", again), ("the first scene, after the second was made", first)):
        expect_same(
            scene,
            kept,
            what=what,
            expected="the same bits",
            change="look for random numbers, or for state that a forward pass leaves behind",
        )


@torch.no_grad()
def copies_compute_the_same(plugin: Plugin) -> None:
    """Deep copies of the aggregator and of the Gaussian head give the same bits, on weights of their own."""
    import copy

    backbone = _frozen(plugin)
    scene = _scene(plugin)
    with attempt("copy.deepcopy of a part", change="keep in the part only what can be copied, no hooks or handles"):
        aggregator, head = copy.deepcopy(backbone.aggregator), copy.deepcopy(backbone.gaussian_head)
    expected, change = "the same bits", "keep all that the part computes with in its parameters and buffers"
    expect_same(aggregator(scene.stem), scene.features, what="features of a copy", expected=expected, change=change)
    attributes = head(scene.features, scene.views.images)
    expect_same(attributes, scene.attributes, what="attributes of a copy", expected=expected, change=change)
    for parameter in (*aggregator.parameters(), *head.parameters()):
        parameter.add_(1.0)
    again = backbone.encode(scene.views)
    expect_same(
        again.attributes,
        scene.attributes,
        what="the original's attributes, after the copy learned",
        expected="unchanged",
        change="do not share tensors outside of parameters and buffers",
    )


def freezing_is_for_good(plugin: Plugin) -> None:
    """After ``freeze`` nothing learns, and every module stays in ``eval`` whatever is asked for."""
    backbone = plugin.build()
    backbone.train()
    loose = [name or "the backbone" for name, module in backbone.named_modules() if not module.training]
    expect(
        not loose,
        given=f"after `train()` {', '.join(loose[:3])} is in eval mode",
        expected="every module in training mode until it is frozen",
        change="do not override `train` in a part",
    )
    frozen = backbone.freeze()
    backbone.train()
    awake = [name for name, module in backbone.named_modules() if module.training]
    learning = [name for name, parameter in backbone.named_parameters() if parameter.requires_grad]
    expect(
        frozen is backbone and not awake and not learning,
        given=f"after `freeze()` and `train()`: in training mode {awake[:3]}, learning {learning[:3]}",
        expected="eval mode, and no parameter that learns",
        change="register every part and layer as a submodule",
    )


def attributes_carry_gradients(plugin: Plugin) -> None:
    """The adapter is differentiable in opacity, scale, rotation and colour."""
    backbone = _frozen(plugin)
    with torch.no_grad():
        scene = _scene(plugin)
    leaves = scene.attributes.map(lambda tensor: tensor.clone().requires_grad_())
    gaussians = backbone.adapter(leaves, scene.geometry, scene.clusters)
    total = torch.zeros(())
    for name, tensor in tensors_of(gaussians).items():
        if tensor.requires_grad:
            weights = torch.randn(tensor.shape, generator=generator(len(name)))
            total = total + (tensor * weights).sum()
    expect(
        total.requires_grad,
        given="Gaussians that do not depend on the attributes by any gradient",
        expected="gradients",
        change="do not detach, round-trip through numpy, or run the adapter under `torch.no_grad`",
    )
    total.backward()
    for name in ("opacity", "scale", "rotation", "color"):
        gradient = getattr(leaves, name).grad
        expect(
            gradient is not None and bool(gradient.any()) and bool(gradient.isfinite().all()),
            given=f"the gradient in `attributes.{name}` is {_describe_gradient(gradient)}",
            expected="finite numbers that are not all 0",
            change=f"use `attributes.{name}` in the adapter, without detaching it",
        )


def expect_cameras(cameras: Cameras, size: tuple[int, int]) -> None:
    """Refuse cameras that are no rigid pinholes of images of ``size``."""
    expect(
        tuple(cameras.size) == tuple(size),
        given=f"cameras of size {tuple(cameras.size)} for images of {tuple(size)}",
        expected="the images' height and width",
        change="pass the size on in this order, and check the axes of images that are not square",
    )
    pose, intrinsics = cameras.world_from_camera, cameras.intrinsics
    rotation = pose[..., :3, :3]
    error = float((rotation @ rotation.mT - torch.eye(3)).abs().max())
    turning = float(torch.linalg.det(rotation).min())
    bottom = float((pose[..., 3, :] - torch.tensor([0.0, 0.0, 0.0, 1.0])).abs().max())
    expect(
        not (error >= 1e-3 or turning <= 0 or bottom != 0),  # NaN is told elsewhere
        given=f"poses with R R^T off the identity by {error:.2g}, det R of {turning:.2g}, last row off by {bottom:.2g}",
        expected="rotations (det 1) and a last row of 0 0 0 1",
        change="normalise quaternions before they become matrices, and flip no single axis",
    )
    focal = float(intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2].min())
    bottom = float((intrinsics[..., 2, :] - torch.tensor([0.0, 0.0, 1.0])).abs().max())
    expect(
        not (focal <= 0 or bottom != 0),
        given=f"intrinsics with a focal length of {focal:.3g} and a last row off by {bottom:.2g}",
        expected="positive focal lengths in pixels, and a last row of 0 0 1",
        change="build them as [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
    )


def _frozen(plugin: Plugin) -> Backbone:
    return plugin.instance.freeze()


def _views(plugin: Plugin, *, batch: int = 1, number: int = 2, shape: tuple[int, int] = SQUARE) -> Views:
    patch = plugin.instance.patch_size
    return views(batch, number, (shape[0] * patch, shape[1] * patch))


@torch.no_grad()
def _scene(plugin: Plugin, batch: int = 1) -> Scene:
    return plugin.once(f"{batch} scenes", lambda: _frozen(plugin).encode(_views(plugin, batch=batch)))


def _gaussians(backbone: Backbone, scene: Scene) -> Gaussians:
    return backbone.adapter(scene.attributes, scene.geometry, scene.clusters)


def _expect_scene(plugin: Plugin, given: Views) -> None:
    batch, number, _, height, width = given.images.shape
    what = f"`encode` of {batch} scene(s), {number} view(s) of {height}x{width} pixels"
    with attempt(what, change="make it work for any number of scenes and views, and any multiple of the patch"):
        scene = _frozen(plugin).encode(given)
    sizes = {"B": batch, "V": number}
    pixels = {**sizes, "H": height, "W": width}
    patch = plugin.instance.patch_size
    conform(scene.stem, Tokens, f"`embedder` in {what}", **sizes)
    _expect_grid(scene.stem, "`embedder`", (height // patch, width // patch))
    expect(
        len(scene.features) > 0,
        given="no features",
        expected="the tokens that the heads read, by their layer",
        change="return them from `aggregator.forward`",
    )
    for layer, tokens in scene.features.items():
        conform(tokens, Tokens, f"`aggregator` at layer {layer} in {what}", **sizes)
        _expect_grid(tokens, f"`aggregator` at layer {layer}", (height // patch, width // patch))
    conform(scene.geometry, Geometry, f"`geometry_head` in {what}", **pixels)
    conform(scene.geometry.cameras, Cameras, f"`geometry_head` in {what}", **sizes)
    conform(scene.attributes, Attributes, f"`gaussian_head` in {what}", **pixels)
    with attempt(f"`adapter` in {what}", change="make it work for any number of scenes, views and pixels"):
        gaussians = _gaussians(plugin.instance, scene)
    conform(gaussians, Gaussians, f"`adapter` in {what}", B=batch)
    expect(
        tuple(scene.cameras.size) == (height, width),
        given=f"cameras of size {tuple(scene.cameras.size)} in {what}",
        expected=f"({height}, {width}), height before width",
        change="pass `size` on as it comes",
    )


def _expect_finite(backbone: Backbone, scene: Scene) -> None:
    for name in ("stem", "features", "geometry", "attributes"):
        expect_finite(getattr(scene, name), f"`{name}`")
    expect_finite(_gaussians(backbone, scene), "the adapter's Gaussians")


def _expect_finite_as_ever(plugin: Plugin, given: Views) -> None:
    # Numbers that are never finite are one finding, told by the check of their own.
    backbone = _frozen(plugin)
    try:
        _expect_finite(backbone, _scene(plugin))
    except ContractError:
        return
    _expect_finite(backbone, backbone.encode(given))


def _expect_grid(tokens: Tokens, where: str, grid: tuple[int, int] | None = None) -> None:
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


def _one_scene(value: Value | Features, index: int) -> Value | Features:
    if isinstance(value, Value):
        return value.map(lambda tensor: tensor[index : index + 1])
    return {layer: tokens.map(lambda tensor: tensor[index : index + 1]) for layer, tokens in value.items()}


def _expect_fusion_by_scene(backbone: Backbone, both: Scene) -> None:
    # Each scene's fusion is repeated on the batch's own numbers: what rounding does before it is no matter here.
    together = _gaussians(backbone, both)
    for index in range(2):
        geometry = both.geometry.map(lambda tensor, i=index: tensor[i : i + 1])
        attributes = both.attributes.map(lambda tensor, i=index: tensor[i : i + 1])
        clusters = backbone.adapter.cluster(geometry, attributes)
        alone = backbone.adapter(attributes, geometry, clusters)
        mine: Gaussians = together.map(lambda tensor, i=index: tensor[i : i + 1])
        if clusters is not None and both.clusters is not None:
            # By pixel, for the order of Gaussians is the adapter's own affair.
            ours, theirs = both.clusters.index[index], clusters.index[0]
            mine, alone = mine.map(lambda t, i=ours: t[:, i]), alone.map(lambda t, i=theirs: t[:, i])
        expect_close(
            mine,
            alone,
            what=f"Gaussians of scene {index} of a batch of two against the same scene alone",
            expected="equal numbers, but for rounding",
            change="fuse each scene by itself in `cluster` and `forward` of the adapter",
        )


def _describe_gradient(gradient: Tensor | None) -> str:
    if gradient is None:
        return "missing"
    return "0 everywhere" if not bool(gradient.any()) else "NaN or infinite somewhere"


CHECKS: tuple[Check, ...] = (
    Check(all_five_parts_are_there, needed=True),
    Check(final_methods_are_left_alone),
    Check(sites_are_named_after_their_part, needed=True, see="ToyAggregator"),
    Check(encodes_two_views, needed=True),
    Check(encodes_a_single_view),
    Check(encodes_every_shape),
    Check(encodes_several_scenes_at_once),
    Check(dtypes_are_kept, see="ToyGeometryHead"),
    Check(numbers_are_finite),
    Check(cameras_are_rigid_pinholes, see="ToyGeometryHead"),
    Check(confidence_is_not_negative, see="ToyGeometryHead"),
    Check(pixels_share_gaussians_fairly, see="ToyAdapter"),
    Check(gaussians_are_renderable, see="ToyAdapter"),
    Check(every_site_is_visited, see="ToyAggregator"),
    Check(injected_tokens_are_used, see="ToyAggregator"),
    Check(untouched_sites_change_nothing, see="ToyAggregator"),
    Check(encoding_twice_is_the_same),
    Check(copies_compute_the_same, see="ToyGaussianHead"),
    Check(freezing_is_for_good),
    Check(attributes_carry_gradients, see="ToyAdapter"),
)
