"""What a renderer promises: see :class:`anystyle.contracts.Renderer`."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import colors, constant_from_rgb
from anystyle.geometry.projection import covariances
from anystyle.testing import asserts
from anystyle.testing.inputs import cameras, gaussians, generator
from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Gaussians, Renders
from anystyle.types.shapes import check_value

SIZE = (24, 32)
GREY, RED, GREEN = (0.5, 0.5, 0.5), (0.9, 0.2, 0.1), (0.1, 0.8, 0.2)


def test_renders_every_camera(plugin: Subject[Renderer]) -> None:
    """It renders any number of scenes, cameras and harmonics, of any size, within the declared ranges."""
    for batch, number, size, coefficients in ((1, 1, SIZE, 1), (2, 3, (33, 17), 4), (1, 2, (16, 16), 9)):
        renders = _render(plugin, gaussians(batch, 20, coefficients), cameras(batch, number, size))
        check_value(renders, Renders, "the renderer", B=batch, V=number, H=size[0], W=size[1])
        asserts.finite(renders, "the renders")
        for name, tensor in asserts.tensors_of(renders).items():
            low, high = float(tensor.min()), float(tensor.max())
            assert low >= -1e-5 and (high <= 1 + 1e-5 or name == "depth"), f"`{name}` from {low:.4g} to {high:.4g}"


def test_transparent_gaussians_are_invisible(plugin: Subject[Renderer]) -> None:
    """Of nothing, alpha and depth are 0 and colour is constant; Gaussians of opacity 0 add nothing to a scene."""
    scene, seen = gaussians(1, 20), cameras(1, 2, SIZE)
    empty = _render(plugin, replace(scene, opacities=torch.zeros_like(scene.opacities)), seen)
    constant = torch.equal(empty.color, empty.color[:, :1, :, :1, :1].expand_as(empty.color))
    assert constant and not bool(empty.alpha.any() | empty.depth.any()), "something is seen where all opacities are 0"
    padding = replace(gaussians(1, 7, seed=5), opacities=torch.zeros(1, 7), scales=torch.zeros(1, 7, 3))
    padded = _render(plugin, Gaussians.cat([scene, replace(padding, means=torch.zeros(1, 7, 3))], dim=1), seen)
    asserts.close(padded, _render(plugin, scene, seen), "renders with seven Gaussians of opacity 0 and scale 0")


def test_order_and_norms_do_not_matter(plugin: Subject[Renderer]) -> None:
    """Gaussians in another order, or with quaternions of another norm, give the same picture; twice the same bits."""
    scene, seen = gaussians(1, 20), cameras(1, 2, SIZE)
    expected = _render(plugin, scene, seen)
    order = torch.randperm(20, generator=generator(2))
    shuffled = _render(plugin, scene.map(lambda tensor: tensor[:, order]), seen)
    asserts.close(shuffled, expected, "renders of Gaussians in another order")
    scaled = _render(plugin, replace(scene, rotations=3.0 * scene.rotations), seen)
    asserts.close(scaled, expected, "renders with quaternions of norm 3")
    asserts.same(_render(plugin, scene, seen), expected, "the same scene again")


def test_batches_are_loops(plugin: Subject[Renderer]) -> None:
    """A batch of scenes and cameras gives what each camera of each scene gives alone."""
    scenes, seen = gaussians(2, 20), cameras(2, 3, SIZE)
    together = _render(plugin, scenes, seen)
    for scene, view in ((0, 0), (0, 2), (1, 1)):
        alone = _render(plugin, scenes.row(scene), seen.row(scene).select([view]))
        mine = together.map(lambda tensor, b=scene, v=view: tensor[b : b + 1, v : v + 1])
        asserts.close(mine, alone, f"camera {view} of scene {scene} of a batch against the same alone")


def test_points_appear_where_they_project(plugin: Subject[Renderer]) -> None:
    """A small Gaussian is seen at its projection, in OpenCV axes, at its own depth, and not from behind.

    Its colour is that of its harmonics in the direction from the camera to it.
    """
    seen, point = cameras(1, 3, (40, 56)), torch.tensor([1.1, -0.7, 0.4])
    harmonics = 0.3 * torch.randn(1, 1, 9, 3, generator=generator(4))
    renders = _render(plugin, replace(_single(point, size=0.05), harmonics=harmonics), seen)
    local = seen.camera_from_world[0, :, :3, :3] @ point + seen.camera_from_world[0, :, :3, 3]  # V 3
    pixel = (seen.intrinsics[0] @ local[..., None])[..., 0]
    alpha = renders.alpha[0].double()
    rows, columns, total = torch.arange(40) + 0.5, torch.arange(56) + 0.5, alpha.sum((1, 2)).clamp_min(1e-9)
    center = torch.stack([(alpha * columns).sum((1, 2)), (alpha * rows[:, None]).sum((1, 2))], dim=-1) / total[:, None]
    expected = pixel[:, :2] / pixel[:, 2:]
    right = float((center - expected).abs().max()) < 0.25
    assert right, f"a Gaussian that projects to pixels {expected.tolist()} is seen at {center.tolist()}"
    depth = renders.depth[0].sum((1, 2)) / total
    right = float((depth / local[:, 2] - 1).abs().max()) < 0.02
    assert right, f"depth over alpha is {depth.tolist()}, and the distance along z is {local[:, 2].tolist()}"
    light = (renders.color[0] - (1 - renders.alpha[0, :, None]) * renders.color[0, :, :, :1, :1]).sum((2, 3))
    away = F.normalize(point - seen.world_from_camera[0, :, :3, 3], dim=-1)
    asserts.close((light / total[:, None]).float(), colors(harmonics[0].expand(3, 9, 3), away), "colours of harmonics")
    behind = _render(plugin, _single(torch.tensor([0.0, 0.0, -6.0]), size=0.2), cameras(1, 1, SIZE))
    assert not bool(behind.alpha.any()), "a Gaussian behind the camera is seen"


def test_long_gaussians_are_turned(plugin: Subject[Renderer]) -> None:
    """A long Gaussian has the extent that its quaternion wxyz gives it across the line of sight."""
    rotation, scales = torch.tensor([[[0.8, 0.5, 0.2, 0.3]]]), torch.tensor([[[0.02, 0.3, 0.02]]])
    turned = replace(_single(torch.zeros(3), size=1.0), rotations=rotation, scales=scales)
    alpha = _render(plugin, turned, cameras(1, 1, (56, 56))).alpha[0, 0]
    share, place = alpha / alpha.sum(), torch.arange(56) - 27.5
    seen = float((share * (place**2 + place[:, None] ** 2)).sum())
    expected = float(covariances(rotation, scales)[0, 0].diagonal()[:2].sum()) * (56 / 4) ** 2
    told = f"a variance of {seen:.1f} pixels² of a long Gaussian, not {expected:.1f}; rotations are wxyz"
    assert 0.85 < seen / expected < 1.3, told  # 1.14 with the usual filter of 0.3 pixels²


def test_antialiased_gaussians_are_fainter(plugin: Subject[Renderer]) -> None:
    """Antialiased Gaussians lose what a pixel's filter adds: thinner than a pixel, nearly all of their alpha."""
    scene, seen = _single(torch.zeros(3), size=0.002), cameras(1, 1, (33, 33))
    before, after = (_render(plugin, scene.marked(mode), seen).alpha.sum() for mode in (False, True))
    assert after < 0.1 * before, "antialiased Gaussians are drawn as others; multiply opacities as their class says"


def test_near_hides_far(plugin: Subject[Renderer]) -> None:
    """An opaque Gaussian hides what is behind it, and shows its own colour."""
    front, back = (_single(torch.tensor([0.0, 0.0, z]), size=1.0, color=c) for z, c in ((-1.0, RED), (1.0, GREEN)))
    for pair in ((front, back), (back, front)):
        middle = _render(plugin, Gaussians.cat(pair, dim=1), cameras(1, 1, (33, 33))).color[0, 0, :, 16, 16]
        assert float((middle - torch.tensor(RED)).abs().max()) < 0.03, f"{middle.tolist()} in front, not {RED}"


def test_everything_carries_gradients(plugin: Subject[Renderer]) -> None:
    """It is differentiable in every field of the Gaussians and in the poses, also beside Gaussians of opacity 0."""
    device, scene, seen = _device(plugin), gaussians(1, 12), cameras(1, 2, SIZE)
    scene = replace(scene, opacities=scene.opacities.index_fill(1, torch.tensor([3]), 0.0))
    leaves: Gaussians = scene.to(device).map(lambda tensor: tensor.clone().requires_grad_())
    poses = seen.world_from_camera.to(device).requires_grad_()
    renders = plugin.instance(leaves, replace(seen.to(device), world_from_camera=poses))
    weights = [torch.rand(tensor.shape, generator=generator(1)).to(device) for tensor in vars(renders).values()]
    torch.autograd.backward(list(vars(renders).values()), weights)
    for name, leaf in (*vars(leaves).items(), ("world_from_camera", poses)):
        asserts.gradient(leaf.grad, f"`{name}`")


def test_a_linear_view_is_linear_and_shows_the_scene(plugin: Subject[Renderer]) -> None:
    """If it has linear views, they show what renders of constant colours show; the transpose has the same products."""
    device, scene, seen = _device(plugin), gaussians(1, 20, 1), cameras(1, 1, (33, 40))
    view = plugin.instance.linear_view(scene.to(device), seen.to(device))
    if view is None:
        return
    colors, pixels = (torch.rand(*shape, generator=generator(3)) for shape in ((20, 3), (3, *seen.size)))
    alike = replace(scene, harmonics=constant_from_rgb(colors)[None, :, None])
    image = view(colors.to(device)).cpu()
    asserts.close(image + view.background.cpu(), _render(plugin, alike, seen).color[0, 0], "its view of colours")
    for name, image_given in vars(view.render.to("cpu")).items():
        asserts.close(image_given, getattr(_render(plugin, scene, seen), name), f"its {name} of the scene")
    asserts.close(view(-2 * colors.to(device)).cpu(), -2 * image, "its view of -2 times these colours")
    products = (image * pixels).sum((1, 2)), (colors * view.transposed(pixels.to(device)).cpu()).sum(0)
    asserts.close(*products, "products with its view and with its transpose")


def _device(plugin: Subject[Renderer]) -> str:
    """The CPU, if the renderer runs on it, or the first type of device that it names; skips the test without one."""
    types = plugin.cls.devices or ("cpu",)
    if "cpu" not in types and not torch.get_device_module(types[0]).is_available():
        pytest.skip(f"it cannot be checked here, for this machine has no device of the type {types[0]}")
    return "cpu" if "cpu" in types else types[0]


@torch.no_grad()
def _render(plugin: Subject[Renderer], scene: Gaussians, seen: Cameras) -> Renders:
    device = _device(plugin)
    return plugin.instance(scene.to(device), seen.to(device)).to("cpu")


def _single(point: Float[Tensor, "3"], *, size: float, color: tuple[float, float, float] = GREY) -> Gaussians:
    rotation, scales = torch.tensor([[[1.0, 0.0, 0.0, 0.0]]]), torch.full((1, 1, 3), size)
    harmonics = constant_from_rgb(torch.tensor(color))[None, None, None]
    return Gaussians(point[None, None], rotation, scales, torch.full((1, 1), 0.99), harmonics)
