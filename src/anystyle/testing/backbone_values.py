"""What a backbone promises of the scenes it encodes: shapes, numbers, cameras, Gaussians."""

import torch

from anystyle.contracts import Backbone
from anystyle.testing.backbone_encoding import (
    Plugin,
    adapted,
    encoded,
    expect_all_finite,
    expect_finite_as_ever,
    expect_scene,
    frozen,
    some_views,
)
from anystyle.testing.check import expect
from anystyle.testing.comparing import conform, expect_close, expect_gradient, tensors_of
from anystyle.testing.inputs import generator
from anystyle.types import Cameras, Clusters, Features, Gaussians, Scene, Value, Views
from anystyle.types.shapes import kind_and_shape

SHAPES = ((2, 3), (3, 2), (5, 4))
"""Heights and widths in patches that must work besides the square."""


@torch.no_grad()
def encodes_two_views(plugin: Plugin) -> None:
    """``encode`` works on two square views of one scene, and every tensor has the shape that its type declares."""
    expect_scene(plugin, some_views(plugin))


@torch.no_grad()
def encodes_a_single_view(plugin: Plugin) -> None:
    """``encode`` works on one view."""
    given = some_views(plugin, number=1)
    expect_scene(plugin, given)
    expect_finite_as_ever(plugin, given)


@torch.no_grad()
def encodes_every_shape(plugin: Plugin) -> None:
    """``encode`` works on images that are not square, and on any multiple of the patch."""
    for shape in SHAPES:
        given = some_views(plugin, shape=shape)
        expect_scene(plugin, given)
        expect_finite_as_ever(plugin, given)


@torch.no_grad()
def encodes_several_scenes_at_once(plugin: Plugin) -> None:
    """A batch of scenes gives what each scene gives alone."""
    together = some_views(plugin, batch=2)
    expect_scene(plugin, together)
    backbone, both = frozen(plugin), encoded(plugin, batch=2)
    for index in range(2):
        alone = backbone.encode(together.row(index))
        for name in ("stem", "features", "geometry", "attributes"):
            expect_close(
                _one_scene(getattr(both, name), index),
                getattr(alone, name),
                what=f"`{name}` of scene {index} of a batch of two against the same scene alone",
                change="look for a sum, mean, reshape or normalisation that runs over axis 0",
            )
    _expect_fusion_by_scene(backbone, both)


@torch.no_grad()
def dtypes_are_kept(plugin: Plugin) -> None:
    """From float32 images come float32 tensors."""
    scene = encoded(plugin)
    for part in ("geometry", "attributes"):
        for name, tensor in tensors_of(getattr(scene, part)).items():
            expect(
                tensor.dtype == torch.float32,
                given=f"`{part}.{name}` is {kind_and_shape(tensor)}",
                change="convert at the end of the head, with `.float()`, or make the numpy arrays it uses float32",
            )


@torch.no_grad()
def numbers_are_finite(plugin: Plugin) -> None:
    """Nothing is NaN or infinite, not for black or white images either."""
    backbone = frozen(plugin)
    images = some_views(plugin).images
    flat = [Views(images=torch.full_like(images, value)) for value in (0.0, 1.0)]
    for scene in (encoded(plugin), *(backbone.encode(given) for given in flat)):
        expect_all_finite(backbone, scene)


@torch.no_grad()
def cameras_are_rigid_pinholes(plugin: Plugin) -> None:
    """Poses are rotations and translations; focal lengths are positive; the size is that of the images."""
    expect_cameras(encoded(plugin).cameras, some_views(plugin).size)


@torch.no_grad()
def confidence_is_not_negative(plugin: Plugin) -> None:
    """The confidence of the depth is at least 0."""
    lowest = float(encoded(plugin).geometry.confidence.min())
    expect(
        not lowest < 0,  # NaN is told elsewhere
        given=f"a confidence of {lowest:.3g}",
        change="end it with an exponential, a sigmoid or a softplus",
    )


@torch.no_grad()
def pixels_share_gaussians_fairly(plugin: Plugin) -> None:
    """Clusters give each pixel a Gaussian that exists, and the weights of a Gaussian's pixels sum to at most 1."""
    given = some_views(plugin, batch=2)
    clusters = encoded(plugin, batch=2).clusters
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
    backbone = frozen(plugin)
    given = some_views(plugin, batch=2)
    scene = encoded(plugin, batch=2)
    gaussians = adapted(backbone, scene)
    pixels = given.images.shape[1] * given.size[0] * given.size[1]
    count = pixels if scene.clusters is None else scene.clusters.means.shape[1]
    conform(gaussians, Gaussians, "`adapter`", B=2, N=count)
    low, high = float(gaussians.opacities.min()), float(gaussians.opacities.max())
    expect(
        not (low < 0 or high > 1),
        given=f"opacities from {low:.3g} to {high:.3g}",
        change="pass the logits through a sigmoid in the adapter",
    )
    smallest = float(gaussians.scales.min())
    expect(
        not smallest < 0,
        given=f"a scale of {smallest:.3g}",
        change="pass scales through an exponential, a sigmoid or a softplus in the adapter",
    )
    if scene.clusters is not None and not bool(scene.clusters.valid.all()):
        padded = float(gaussians.opacities[~scene.clusters.valid].max())
        expect(
            padded == 0,
            given=f"a padded Gaussian of opacity {padded:.3g}",
            change="multiply the opacities by `clusters.valid`",
        )


def attributes_carry_gradients(plugin: Plugin) -> None:
    """The adapter is differentiable in opacity, scale, rotation and colour."""
    backbone = frozen(plugin)
    with torch.no_grad():
        scene = encoded(plugin)
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
        change="do not detach, round-trip through numpy, or run the adapter under `torch.no_grad`",
    )
    total.backward()
    for name in ("opacity", "scale", "rotation", "color"):
        gradient = getattr(leaves, name).grad
        change = f"use `attributes.{name}` in the adapter, without detaching it"
        if gradient is not None and not bool(gradient.isfinite().all()):
            change = "look in the adapter, and in the geometry that it is given, for what is no number"
        expect_gradient(gradient, f"`attributes.{name}`", change=change)


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


def _one_scene(value: Value | Features, index: int) -> Value | Features:
    if isinstance(value, Value):
        return value.row(index)
    return {layer: tokens.row(index) for layer, tokens in value.items()}


def _expect_fusion_by_scene(backbone: Backbone, both: Scene) -> None:
    # Each scene's fusion is repeated on the batch's own numbers: what rounding does before it is no matter here.
    together = adapted(backbone, both)
    for index in range(2):
        geometry, attributes = both.geometry.row(index), both.attributes.row(index)
        clusters = backbone.adapter.cluster(geometry, attributes)
        alone = backbone.adapter(attributes, geometry, clusters)
        mine: Gaussians = together.row(index)
        if clusters is not None and both.clusters is not None:
            # By pixel, for the order of Gaussians is the adapter's own affair.
            ours, theirs = both.clusters.index[index], clusters.index[0]
            mine, alone = mine.map(lambda t, i=ours: t[:, i]), alone.map(lambda t, i=theirs: t[:, i])
        expect_close(
            mine,
            alone,
            what=f"Gaussians of scene {index} of a batch of two against the same scene alone",
            change="fuse each scene by itself in `cluster` and `forward` of the adapter",
        )
