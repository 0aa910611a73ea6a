"""Properties of renders, and the fast renderer against the readable one."""

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from anystyle.geometry.harmonics import rotate
from anystyle.geometry.transforms import matrix_from_wxyz, multiply
from anystyle.renderers.gsplat import GsplatRenderer
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians, Renders
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.scenes import cameras, gaussians, warp

cuda = pytest.param(
    GsplatRenderer, marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat needs a CUDA device")
)
RENDERERS = [TorchRenderer, CpuRenderer, warp, cuda]
NAMES = [field.name for field in fields(Gaussians)]


def render(renderer: Any, scene: Gaussians, views: Cameras, **options: Any) -> Renders:
    """Render on the device that the renderer is for."""
    device = "cuda" if renderer is GsplatRenderer else "cpu"
    return renderer(**options)(scene.to(device), views.to(device)).to("cpu")


def assert_same(actual: Renders, expected: Renders, atol: float = 1e-5) -> None:
    torch.testing.assert_close(vars(actual), vars(expected), rtol=1e-5, atol=atol)


def with_gradients(scene: Gaussians, views: Cameras) -> tuple[Gaussians, Cameras, list[Tensor]]:
    scene = scene.map(lambda tensor: tensor.clone().requires_grad_())
    views = views.map(lambda tensor: tensor.clone().requires_grad_())
    return scene, views, [*(getattr(scene, name) for name in NAMES), views.world_from_camera, views.intrinsics]


def objective(renders: Renders) -> Tensor:
    """A sum with random weights of everything a render holds."""
    generator = torch.Generator().manual_seed(5)

    def weigh(image: Tensor) -> Tensor:
        weights = torch.rand(image.shape, generator=generator, dtype=torch.float64) - 0.5
        return (image * weights.to(image)).sum()

    return weigh(renders.color) + 0.1 * weigh(renders.depth) + weigh(renders.alpha)


@pytest.mark.parametrize("renderer", [CpuRenderer, warp, cuda])
@pytest.mark.parametrize(
    ("degree", "size", "antialiased"),
    [(0, (37, 29), False), (1, (16, 48), False), (4, (33, 20), False), (1, (16, 48), True)],
)
def test_agrees_with_the_specification(renderer: Any, degree: int, size: tuple[int, int], antialiased: bool) -> None:
    scene, views = gaussians(2, 250, degree).marked(antialiased), cameras(2, 3, size)
    exact = TorchRenderer()(scene.to(torch.float64), views.to(torch.float64)).to(torch.float32)
    assert_same(render(renderer, scene, views), exact, atol=2e-5)


@pytest.mark.parametrize("renderer", [CpuRenderer, warp])
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(("degree", "size"), [(0, (37, 29)), (3, (16, 48)), (4, (33, 20))])
def test_gradients_agree_with_the_specification(
    renderer: Any, degree: int, size: tuple[int, int], antialiased: bool
) -> None:
    """Of the Gaussians, the poses and the intrinsics; half of the Gaussians lie outside of the frustum or behind it."""
    scene, views = gaussians(2, 300, degree, seed=3).marked(antialiased), cameras(2, 2, size, distance=1.0)
    *inputs, leaves = with_gradients(scene.to(torch.float64), views.to(torch.float64))
    expected = torch.autograd.grad(objective(TorchRenderer(near=0.05)(*inputs)), leaves)
    *inputs, leaves = with_gradients(scene, views)
    actual = torch.autograd.grad(objective(renderer(near=0.05)(*inputs)), leaves)
    for name, value, exact in zip([*NAMES, "poses", "intrinsics"], actual, expected, strict=True):
        error = (value - exact).norm() / exact.norm()
        assert exact.norm() > 0, name
        assert error < 1e-4, f"{name}: relative error {error:.1e}"
    harmonics = scene.harmonics.clone().requires_grad_()
    renders = renderer(near=0.05)(replace(scene, harmonics=harmonics), views)
    torch.testing.assert_close(torch.autograd.grad(objective(renders), harmonics)[0], actual[4])


@pytest.mark.parametrize("antialiased", [False, True])
def test_gradients_of_the_specification(antialiased: bool) -> None:
    """Against finite differences, where the image is smooth: no Gaussian is near the least alpha."""
    scene, views = gaussians(1, 3, 2, dtype=torch.float64), cameras(1, 1, (2, 3), dtype=torch.float64)
    scene = replace(scene, scales=scene.scales + 1.5, opacities=0.3 + 0.3 * scene.opacities)

    def image(*leaves: Tensor) -> Tensor:
        seen = Cameras(leaves[5], leaves[6], views.size)
        renders = TorchRenderer(background=(0.2, 0.4, 0.6))(Gaussians(*leaves[:5]).marked(antialiased), seen)
        return torch.cat([renders.color.flatten(), renders.depth.flatten(), renders.alpha.flatten()])

    *_, leaves = with_gradients(scene, views)
    assert torch.autograd.gradcheck(image, leaves, eps=1e-6, atol=1e-6, fast_mode=True)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_antialiased_gaussians_lose_what_a_pixel_s_filter_adds(renderer: Any) -> None:
    """Of 0.1 pixels² and opacity 0.9: 0.9 sqrt(0.1² / 0.4²), which gsplat's mode of this name draws."""
    pose, intrinsics = torch.eye(4)[None, None], torch.tensor([[[[8.0, 0.0, 4.5], [0.0, 8.0, 4.5], [0.0, 0.0, 1.0]]]])
    scale, turn = torch.full((1, 1, 3), math.sqrt(0.1) / 4), torch.tensor([[[1.0, 0.0, 0.0, 0.0]]])
    scene = Gaussians(torch.tensor([[[0.0, 0.0, 2.0]]]), turn, scale, torch.tensor([[0.9]]), torch.zeros(1, 1, 1, 3))
    for antialiased, alpha in ((False, 0.9), (True, 0.225)):
        shown = render(renderer, scene.marked(antialiased), Cameras(pose, intrinsics, (9, 9)))
        assert float(shown.alpha[0, 0, 4, 4]) == pytest.approx(alpha, abs=1e-4)
        flat = replace(scene.marked(antialiased), scales=scale * torch.tensor([1.0, 0.0, 1.0]))
        assert bool(render(renderer, flat, Cameras(pose, intrinsics, (9, 9))).alpha.any()) != antialiased


@pytest.mark.parametrize("renderer", RENDERERS)
def test_one_gaussian_is_a_gaussian(renderer: Any) -> None:
    """Isotropic and on the optical axis: variance (focal scale / depth)² + eps2d, in closed form at pixel centres."""
    focal, depth, scale, opacity, eps2d, size = 40.0, 2.0, 0.15, 0.8, 0.5, 33
    scene = Gaussians(
        means=torch.tensor([[[0.0, 0.0, depth]]]),
        rotations=torch.tensor([[[2.0, 0.0, 0.0, 0.0]]]),
        scales=torch.full((1, 1, 3), scale),
        opacities=torch.tensor([[opacity]]),
        harmonics=torch.tensor([0.3, -0.2, 0.1])[None, None, None],
    )
    intrinsics = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    views = Cameras(torch.eye(4)[None, None], intrinsics[None, None], (size, size))
    variance = (focal * scale / depth) ** 2 + eps2d
    offset = torch.arange(size) + 0.5 - size / 2
    alpha = opacity * torch.exp(-(offset[:, None] ** 2 + offset**2) / (2 * variance))
    alpha = torch.where(alpha < 1 / 255, 0, alpha)
    color = torch.tensor([0.3, -0.2, 0.1]) * 0.5 / math.sqrt(math.pi) + 0.5
    background = torch.tensor([0.9, 0.5, 0.1])

    renders = render(renderer, scene, views, background=tuple(background.tolist()), eps2d=eps2d)
    torch.testing.assert_close(renders.alpha[0, 0], alpha, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(renders.depth[0, 0], depth * alpha, rtol=1e-5, atol=1e-6)
    composed = color[:, None, None] * alpha + background[:, None, None] * (1 - alpha)
    torch.testing.assert_close(renders.color[0, 0], composed, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("renderer", [TorchRenderer, CpuRenderer, warp])
@pytest.mark.parametrize(("cap", "shown"), [(0.999, 1), (0.95, 3), (0.5, 13)])
def test_a_pixel_is_full(renderer: Any, cap: float, shown: int) -> None:
    """Opaque layers each let 1 - cap pass; the one that would leave at most 1e-4 is not blended, nor any behind it."""
    layers = 20
    depths = torch.linspace(3, 2, layers)
    scene = Gaussians(
        means=torch.stack([0 * depths, 0 * depths, depths], dim=-1)[None],
        rotations=torch.tensor([1.0, 0, 0, 0]).expand(1, layers, 4),
        scales=torch.full((1, layers, 3), 500.0),
        opacities=torch.ones(1, layers),
        harmonics=torch.zeros(1, layers, 1, 3),
    )
    views = Cameras(
        torch.eye(4)[None, None], torch.tensor([[20.0, 0, 10], [0, 20, 8], [0, 0, 1]])[None, None], (16, 20)
    )
    renders = renderer(alpha_cap=cap)(scene, views)
    weights = cap * (1 - cap) ** torch.arange(shown)
    depth = (weights * depths.flip(0)[:shown]).sum()
    torch.testing.assert_close(renders.alpha, torch.full((1, 1, 16, 20), 1 - (1 - cap) ** shown), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(renders.depth, depth.expand(1, 1, 16, 20), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_turning_the_world_changes_nothing(renderer: Any) -> None:
    scene, views = gaussians(1, 150, 4), cameras(1, 2, (40, 30))
    turn = torch.tensor([0.3, -0.7, 0.5, 0.4])
    rotation, shift = matrix_from_wxyz(turn), torch.tensor([0.4, -1.0, 2.0])
    motion = torch.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, shift
    turned = replace(
        scene,
        means=scene.means @ rotation.T + shift,
        rotations=multiply(turn.expand_as(scene.rotations), scene.rotations),
        harmonics=rotate(scene.harmonics, rotation),
    )
    moved = replace(views, world_from_camera=motion @ views.world_from_camera)
    assert_same(render(renderer, turned, moved), render(renderer, scene, views), atol=5e-5)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_doubling_the_world_doubles_depth_alone(renderer: Any) -> None:
    scene, views = gaussians(1, 150), cameras(1, 2, (40, 30))
    pose = views.world_from_camera.clone()
    pose[..., :3, 3] *= 2
    larger = replace(scene, means=2 * scene.means, scales=2 * scene.scales)
    renders = render(renderer, scene, views)
    doubled = render(renderer, larger, replace(views, world_from_camera=pose))
    assert_same(doubled, replace(renders, depth=2 * renders.depth), atol=5e-5)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_padding_is_not_seen_and_has_no_gradient(renderer: Any) -> None:
    scene, views = gaussians(1, 60), cameras(1, 2, (20, 30))
    padded = scene.map(lambda t: torch.cat([t, torch.zeros_like(t[:, :20])], dim=1))
    padded, seen, leaves = with_gradients(padded, views)
    renders = render(renderer, padded, seen)
    assert_same(renders.detach(), render(renderer, scene, views), atol=1e-6)
    for name, gradient in zip(NAMES, torch.autograd.grad(objective(renders), leaves[:5]), strict=True):
        assert gradient.isfinite().all() and not gradient[:, 60:].any() and gradient[:, :60].any(), name


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("coefficients", [1, 4])
def test_few_gaussians(renderer: Any, number: int, coefficients: int) -> None:
    scene = gaussians(2, number, math.isqrt(coefficients) - 1)
    scene, views, leaves = with_gradients(scene, cameras(2, 1, (5, 7)))
    renders = render(renderer, scene, views, background=(0.25, 0.5, 1.0))
    assert renders.color.shape == (2, 1, 3, 5, 7) and renders.depth.shape == renders.alpha.shape == (2, 1, 5, 7)
    if number == 0:
        assert torch.equal(renders.color, torch.tensor([0.25, 0.5, 1.0])[:, None, None].expand(2, 1, 3, 5, 7))
        assert not renders.alpha.any() and not renders.depth.any()
    else:
        assert all(gradient.isfinite().all() for gradient in torch.autograd.grad(objective(renders), leaves[:5]))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_hostile_scenes_have_finite_gradients(renderer: Any) -> None:
    """Centres behind, beside and in the camera, needles, points, quaternions of 0, all at the published near plane."""
    scene, views = gaussians(1, 400, 1, seed=7), cameras(1, 2, (24, 24), distance=0.3)
    scales, rotations, means = scene.scales.clone(), scene.rotations.clone(), scene.means.clone()
    scales[:, :50], scales[:, 50:100, 0], scales[:, 100:110] = 0, 30, 1e-8
    rotations[:, :20] = 0
    means[:, 0] = views.world_from_camera[0, 0, :3, 3]
    means[:, 1] = views.world_from_camera[0, 0, :3, 3] + 1e-6 * views.world_from_camera[0, 0, :3, 2]
    scene, views, leaves = with_gradients(replace(scene, scales=scales, rotations=rotations, means=means), views)
    renders = render(renderer, scene, views)
    assert renders.color.isfinite().all() and renders.depth.isfinite().all()
    for name, gradient in zip([*NAMES, "poses"], torch.autograd.grad(objective(renders), leaves[:6]), strict=True):
        assert gradient.isfinite().all(), name


@pytest.mark.parametrize("renderer", RENDERERS)
def test_near_and_far_cut_centres(renderer: Any) -> None:
    scene, views = gaussians(1, 100), cameras(1, 1, (20, 20))
    depth = (scene.means[0] @ views.camera_from_world[0, 0, :3, :3].T + views.camera_from_world[0, 0, :3, 3])[:, 2]
    kept = ((depth >= 2.7) & (depth <= 3.4)).nonzero()[:, 0]
    assert 10 < len(kept) < 90
    cut = render(renderer, scene, views, near=2.7, far=3.4)
    assert_same(cut, render(renderer, scene.map(lambda t: t[:, kept]), views), atol=1e-6)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_colours_are_cut_with_their_gradients(renderer: Any) -> None:
    """Bright colours end at 1, where they have no gradient."""
    scene, views = gaussians(1, 50), cameras(1, 1, (20, 20))
    harmonics = torch.full_like(scene.harmonics, 10.0).requires_grad_()
    renders = render(renderer, replace(scene, harmonics=harmonics), views)
    assert renders.color.max() == 1
    (gradient,) = torch.autograd.grad(renders.color.sum(), harmonics)
    assert (gradient == 0).all()


@pytest.mark.parametrize("renderer", RENDERERS)
def test_half_precision_training_renders_in_full(renderer: Any) -> None:
    scene, views = gaussians(1, 100, 1), cameras(1, 2, (20, 30))
    expected = render(renderer, scene, views)
    with torch.autocast("cuda" if renderer is GsplatRenderer else "cpu", dtype=torch.bfloat16):
        actual = render(renderer, scene, views)
    assert torch.equal(actual.color, expected.color)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_half_precision_gaussians_render_in_full(renderer: Any) -> None:
    """What a network in half precision puts out is projected in single, with gradients in half."""
    half = gaussians(1, 100, 1).to(torch.bfloat16)
    views = cameras(1, 2, (20, 30))
    assert_same(render(renderer, half, views), render(renderer, half.to(torch.float32), views), atol=0)
    half, _, leaves = with_gradients(half, views)
    gradients = torch.autograd.grad(objective(render(renderer, half, views)), leaves[:5])
    assert all(gradient.dtype == torch.bfloat16 for gradient in gradients)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_double_precision_in_and_out(renderer: Any) -> None:
    scene, views = gaussians(1, 100, 1), cameras(1, 2, (20, 30))
    renders = render(renderer, scene.to(torch.float64), views.to(torch.float64))
    assert renders.color.dtype == renders.depth.dtype == renders.alpha.dtype == torch.float64
    assert_same(renders.to(torch.float32), render(renderer, scene, views), atol=2e-5)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_inference_mode(renderer: Any) -> None:
    scene, views = gaussians(1, 100, 1), cameras(1, 2, (20, 30))
    expected = render(renderer, scene, views)
    with torch.inference_mode():
        assert torch.equal(render(renderer, gaussians(1, 100, 1), cameras(1, 2, (20, 30))).color, expected.color)


@pytest.mark.parametrize("degree", [0, 2])
def test_same_bits_for_any_number_of_threads(degree: int) -> None:
    scene, views = gaussians(1, 20000, degree), cameras(1, 2, (70, 50))

    def run() -> list[Tensor]:
        *inputs, leaves = with_gradients(scene, views)
        renders = CpuRenderer()(*inputs)
        return [renders.color, *torch.autograd.grad(objective(renders), leaves)]

    threads = torch.get_num_threads()
    results = []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            results.append(run())
    finally:
        torch.set_num_threads(threads)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("renderer", [CpuRenderer, warp])
def test_expanded_scenes(renderer: Any) -> None:
    """One scene in many styles shares its geometry without copies; gradients add up."""
    scene, views = gaussians(1, 80), cameras(1, 2, (20, 30))
    means = scene.means.clone().requires_grad_()
    shared = replace(scene, means=means).expand(3)
    gradient = torch.autograd.grad(objective(renderer()(shared, views.expand(3))), means)[0]
    separate = [means.detach().clone().requires_grad_() for _ in range(3)]
    stacked = replace(scene.expand(3), means=torch.cat(separate))
    expected = torch.autograd.grad(objective(renderer()(stacked, views.expand(3))), separate)
    torch.testing.assert_close(gradient, sum(expected), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("renderer", [TorchRenderer, CpuRenderer])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda scene, views: (scene, views.expand(1).map(lambda t: torch.cat([t, t]))), "1 scenes and cameras of 2"),
        (lambda scene, views: (replace(scene, harmonics=scene.harmonics.expand(1, 10, 2, 3)), views), "2 spherical"),
        (lambda scene, views: (scene, replace(views, size=(0, 4))), "0x4 pixels"),
        (lambda scene, views: (scene.to("meta"), views), "meta and cameras on cpu"),
    ],
)
def test_refuses(renderer: Any, change: Callable[..., tuple[Gaussians, Cameras]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        renderer()(*change(gaussians(1, 10), cameras(1, 1, (4, 4))))


def test_refuses_other_devices() -> None:
    scene, views = gaussians(1, 10), cameras(1, 1, (4, 4))
    with pytest.raises(ValueError, match="CpuRenderer runs on cpu, and the tensors are on meta"):
        CpuRenderer()(scene.to("meta"), views.to("meta"))
    with pytest.raises(ValueError, match="renderer=auto"):
        GsplatRenderer()(scene, views)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "size", "views"), [(500_000, 112, 10), (200_000, 448, 1)])
def test_memory_is_bounded(number: int, size: int, views: int) -> None:
    """Forward and backward of a large scene stay under 2 GB, everything in the process included."""
    script = f"""
import sys
sys.path[:0] = {sys.path!r}
from tests.support.scenes import cameras, gaussians
from anystyle_cpu_renderer.renderer import CpuRenderer
scene = gaussians(1, {number}).map(lambda tensor: tensor.requires_grad_())
CpuRenderer()(scene, cameras(1, {views}, ({size}, {size}))).color.mean().backward()
# getrusage would count the peak of the process that started this one.
print(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert int(result.stdout) * 1024 < 2e9


def test_linear_views_of_a_card_are_those_of_the_processor() -> None:
    """Warp blends again what it projected once; shares of the processor's kernels have 16 bits."""
    pytest.importorskip("warp")
    scene, view = gaussians(1, 300, 2), cameras(1, 1, (45, 60))
    one, other = (made(background=(0.2, 0.5, 0.8)).linear_view(scene, view) for made in (CpuRenderer, warp.values[0]))
    colors, pixels = torch.randn(300, 3), torch.randn(3, 45, 60)
    assert_same(other.render, one.render)
    pairs = {"background": 1e-4, "image": 1e-3, "sums": 2e-3}
    found = ((each.background, each(colors), each.transposed(pixels)) for each in (one, other))
    for (name, atol), expected, actual in zip(pairs.items(), *found, strict=True):
        torch.testing.assert_close(
            actual, expected, rtol=1e-3, atol=atol, msg=lambda told, name=name: f"{name}: {told}"
        )
    assert not other(colors).requires_grad
