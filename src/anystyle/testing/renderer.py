"""What a renderer promises: see :class:`anystyle.contracts.Renderer`."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.testing.check import Check, Unavailable, attempt, expect
from anystyle.testing.comparing import conform, expect_close, expect_finite, expect_gradient, expect_same, tensors_of
from anystyle.testing.inputs import cameras, gaussians, generator
from anystyle.testing.subject import Subject
from anystyle.types import Cameras, Gaussians, Renders

Plugin = Subject[Renderer]

SIZE = (24, 32)
HARMONIC_0 = 0.28209479177387814


def renders_every_camera(plugin: Plugin) -> None:
    """It renders any number of scenes, cameras and harmonics, of any size, within the declared ranges."""
    for batch, number, size, coefficients in ((1, 1, SIZE, 1), (2, 3, (33, 17), 4), (1, 2, (16, 16), 9)):
        what = f"{batch} scene(s), {number} camera(s) of {size[0]}x{size[1]} pixels, {coefficients} harmonics"
        with attempt(f"rendering {what}", change="make it work for any number of scenes, cameras and pixels"):
            renders = _render(plugin, gaussians(batch, 20, coefficients), cameras(batch, number, size))
        conform(renders, Renders, f"the renderer on {what}", B=batch, V=number, H=size[0], W=size[1])
        expect_finite(renders, f"renders of {what}")
        for name, tensor in tensors_of(renders).items():
            low, high = float(tensor.min()), float(tensor.max())
            limit = float("inf") if name == "depth" else 1.0
            expect(
                low >= -1e-5 and high <= limit + 1e-5,
                given=f"`{name}` from {low:.4g} to {high:.4g}",
                expected=f"within [0, {limit}]",
                change="clamp colours, and accumulate only what earlier Gaussians let through",
            )


def empty_scenes_show_the_background(plugin: Plugin) -> None:
    """Where nothing is, alpha and depth are 0 and the colour is the same everywhere."""
    scene = gaussians(1, 20)
    renders = _render(plugin, replace(scene, opacities=torch.zeros_like(scene.opacities)), cameras(1, 2, SIZE))
    spread = float((renders.color - renders.color[:, :1, :, :1, :1]).abs().max())
    expect(
        spread == 0 and not bool(renders.alpha.any()) and not bool(renders.depth.any()),
        given=f"colours that differ by {spread:.3g}, alpha up to {float(renders.alpha.max()):.3g} and depth up to "
        f"{float(renders.depth.max()):.3g} for Gaussians of opacity 0",
        change="start from the background's share `1 - alpha`, and skip what is transparent",
    )


def padding_is_invisible(plugin: Plugin) -> None:
    """More Gaussians of opacity 0 change nothing, wherever they lie."""
    scene, seen = gaussians(1, 20), cameras(1, 2, SIZE)
    extra = replace(gaussians(1, 7, seed=5), opacities=torch.zeros(1, 7))
    extra = replace(extra, means=extra.means.index_fill(1, torch.tensor([0, 1]), 0.0), scales=extra.scales * 0)
    joined = {name: torch.cat([tensor, getattr(extra, name)], dim=1) for name, tensor in tensors_of(scene).items()}
    expect_close(
        _render(plugin, Gaussians(**joined), seen),
        _render(plugin, scene, seen),
        what="renders with seven padded Gaussians",
        change="multiply by the opacity before anything else, and let scales of 0 make no NaN",
    )


def order_does_not_matter(plugin: Plugin) -> None:
    """Gaussians in another order give the same picture."""
    scene, seen = gaussians(1, 20), cameras(1, 2, SIZE)
    turned = torch.randperm(20, generator=generator(2))
    expect_close(
        _render(plugin, scene.map(lambda tensor: tensor[:, turned]), seen),
        _render(plugin, scene, seen),
        what="renders of Gaussians in another order",
        change="sort by depth in each camera before blending",
    )


def batches_are_loops(plugin: Plugin) -> None:
    """A batch of scenes and cameras gives what each camera of each scene gives alone."""
    scenes, seen = gaussians(2, 20), cameras(2, 3, SIZE)
    together = _render(plugin, scenes, seen)
    for scene in range(2):
        for view in range(3):
            alone = _render(plugin, scenes.row(scene), seen.row(scene).select([view]))
            expect_close(
                together.map(lambda tensor, b=scene, v=view: tensor[b : b + 1, v : v + 1]),
                alone,
                what=f"camera {view} of scene {scene} of a batch against the same alone",
                change="sort and blend each camera of each scene by itself",
            )


def points_appear_where_they_project(plugin: Plugin) -> None:
    """A small Gaussian is seen at its projection, in OpenCV axes, at its own depth, and not from behind."""
    seen = cameras(1, 3, (40, 56))
    point = torch.tensor([0.5, -0.3, 0.4])
    renders = _render(plugin, _single(point, size=0.05), seen)
    local = seen.camera_from_world[0, :, :3, :3] @ point + seen.camera_from_world[0, :, :3, 3]  # V 3
    pixel = (seen.intrinsics[0] @ local[..., None])[..., 0]
    expected = pixel[:, :2] / pixel[:, 2:]
    alpha = renders.alpha[0].double()
    rows, columns = torch.arange(40) + 0.5, torch.arange(56) + 0.5
    total = alpha.sum((1, 2)).clamp_min(1e-9)
    centroid = torch.stack([(alpha * columns).sum((1, 2)) / total, (alpha * rows[:, None]).sum((1, 2)) / total], dim=-1)
    gap = float((centroid - expected).abs().max())
    expect(
        gap < 0.25,
        given=f"a Gaussian that should be at pixels {_pixels(expected)} is seen at {_pixels(centroid)}",
        expected="the pixel of its projection, the centre of the first pixel being (0.5, 0.5)",
        change="x is right, y is down, z is forward; `camera_from_world` before `intrinsics`",
    )
    depth = renders.depth[0].sum((1, 2)) / total
    gap = float((depth - local[:, 2]).abs().max())
    expect(
        gap < 0.02 * float(local[:, 2].max()),
        given=f"depth over alpha of {_pixels(depth[:, None])}",
        expected=f"the distance along z, {_pixels(local[:, 2:])}",
        change="accumulate weight times z, and leave the division to the caller",
    )
    behind = _render(plugin, _single(torch.tensor([0.0, 0.0, -6.0]), size=0.2), cameras(1, 1, SIZE))
    expect(
        not bool(behind.alpha.any()),
        given=f"alpha up to {float(behind.alpha.max()):.3g} from a Gaussian behind the camera",
        change="skip Gaussians whose z is below the near plane",
    )


def near_hides_far(plugin: Plugin) -> None:
    """An opaque Gaussian hides what is behind it, and shows its own colour, harmonics and all."""
    color = torch.tensor([0.9, 0.2, 0.1])
    front = _single(torch.tensor([0.0, 0.0, -1.0]), size=1.0, color=color)
    back = _single(torch.tensor([0.0, 0.0, 1.0]), size=1.0, color=torch.tensor([0.1, 0.8, 0.2]))
    for pair in ((front, back), (back, front)):
        both = {name: torch.cat([getattr(item, name) for item in pair], dim=1) for name in tensors_of(front)}
        middle = _render(plugin, Gaussians(**both), cameras(1, 1, (33, 33))).color[0, 0, :, 16, 16]
        gap = float((middle - color).abs().max())
        expect(
            gap < 0.03,
            given=f"the colour {[round(value, 3) for value in middle.tolist()]} in the middle of the picture",
            expected=f"{[round(value, 3) for value in color.tolist()]}, that of the nearer of two opaque Gaussians",
            change="blend from near to far; a colour is 0.5 plus the harmonics' sum, cut at 0",
        )


def quaternions_have_any_norm(plugin: Plugin) -> None:
    """A quaternion and its multiples are one rotation."""
    scene, seen = gaussians(1, 20), cameras(1, 2, SIZE)
    expect_close(
        _render(plugin, replace(scene, rotations=3.0 * scene.rotations), seen),
        _render(plugin, scene, seen),
        what="renders with quaternions of norm 3",
        change="normalise quaternions before they become matrices",
    )


def rendering_twice_is_the_same(plugin: Plugin) -> None:
    """The same scene gives the same bits."""
    scene, seen = gaussians(2, 20), cameras(2, 2, SIZE)
    first = _render(plugin, scene, seen).map(Tensor.clone)
    expect_same(
        _render(plugin, scene, seen),
        first,
        what="the same scene again",
        change="add in a fixed order, whatever the number of threads",
    )


def everything_carries_gradients(plugin: Plugin) -> None:
    """It is differentiable in every field of the Gaussians and in the poses, also beside padded Gaussians."""
    device = _device(plugin)
    scene = gaussians(1, 12)
    scene = replace(scene, opacities=scene.opacities.index_fill(1, torch.tensor([3]), 0.0)).to(device)
    leaves: Gaussians = scene.map(lambda tensor: tensor.clone().requires_grad_())
    seen = cameras(1, 2, SIZE).to(device)
    poses = seen.world_from_camera.clone().requires_grad_()
    renders = plugin.instance(leaves, replace(seen, world_from_camera=poses))
    total = torch.zeros((), device=device)
    for index, tensor in enumerate(tensors_of(renders).values()):
        total = total + (tensor * torch.rand(tensor.shape, generator=generator(index)).to(device)).sum()
    with attempt("the backward pass", change="stay within torch, or write the backward pass of what is not"):
        total.backward()
    for name, leaf in {**tensors_of(leaves), "world_from_camera": poses}.items():
        change = "do not detach it; a square root or a division needs a floor where its argument can be 0"
        expect_gradient(leaf.grad, f"`{name}`", change=change)


def _device(plugin: Plugin) -> str:
    # The CPU, unless the renderer says that it needs CUDA.
    try:
        plugin.instance(gaussians(1, 2), cameras(1, 1, (16, 16)))
    except (ValueError, ImportError) as error:
        if "cuda" not in str(error).lower():
            raise
        if not torch.cuda.is_available():
            raise Unavailable(f"it cannot be checked here, for this machine has no CUDA device: {error}") from error
        return "cuda"
    return "cpu"


@torch.no_grad()
def _render(plugin: Plugin, scene: Gaussians, seen: Cameras) -> Renders:
    device = _device(plugin)
    return plugin.instance(scene.to(device), seen.to(device)).to("cpu")


def _single(point: Float[Tensor, "3"], *, size: float, color: Float[Tensor, "3"] | None = None) -> Gaussians:
    chosen = torch.tensor([0.5, 0.5, 0.5]) if color is None else color
    return Gaussians(
        means=point[None, None],
        rotations=torch.tensor([[[1.0, 0.0, 0.0, 0.0]]]),
        scales=torch.full((1, 1, 3), size),
        opacities=torch.full((1, 1), 0.99),
        harmonics=((chosen - 0.5) / HARMONIC_0)[None, None, None],
    )


def _pixels(values: Tensor) -> str:
    return ", ".join(f"({', '.join(f'{number:.2f}' for number in row)})" for row in values.tolist())


CHECKS: tuple[Check, ...] = (
    Check(renders_every_camera, needed=True),
    Check(empty_scenes_show_the_background),
    Check(padding_is_invisible),
    Check(order_does_not_matter),
    Check(batches_are_loops),
    Check(points_appear_where_they_project),
    Check(near_hides_far),
    Check(quaternions_have_any_norm),
    Check(rendering_twice_is_the_same),
    Check(everything_carries_gradients),
)
