"""Renders against gsplat's own reference implementation."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.oracle import assert_matches, hashed
from anystyle.types import Cameras, Gaussians
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.oracle import golden
from tests.support.real_data import real
from tests.support.scenes import warp

GOLDEN = golden("golden_render")
INPUTS = ("means", "quats", "scales", "opacities", "sh")


def read(rule: str, shape: tuple[int, ...]) -> Tensor:
    """An input by its rule in the golden, such as ``exp(in(2203,[N,3],-3.5,-1.5))``."""
    index, _, rest = rule.partition("in(")[2].partition(",")
    low, high = rest.partition("],")[2].partition(")")[0].split(",")
    values = hashed(int(index), shape, float(low), float(high))
    return values.exp() if rule.startswith("exp") else values


def leaves_of(case: str) -> list[Tensor]:
    inputs = GOLDEN[case]["inputs"]
    number, coefficients = inputs["N"], (inputs["sh_degree"] + 1) ** 2
    shapes = [(number, 3), (number, 4), (number, 3), (number,), (number, coefficients, 3)]
    leaves = [read(inputs[name], shape) for name, shape in zip(INPUTS, shapes, strict=True)]
    leaves[4][:, 1:] *= 0.4
    return [leaf.requires_grad_() for leaf in leaves]


def cameras() -> Cameras:
    about = GOLDEN["cameras"]
    pose = torch.linalg.inv(torch.tensor(about["viewmats_w2c"]))
    return Cameras(pose[None], torch.tensor(about["K"]).expand(1, len(pose), 3, 3), (about["H"], about["W"]))


def accumulated(renderer: Any, leaves: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Colour ``[C H W 3]`` over black and before the cut at 1, alpha and depth ``[C H W]``."""
    image = renderer.accumulate(Gaussians(*(leaf[None] for leaf in leaves)), cameras())[0]
    return image[:, :3].movedim(1, -1), 1 - image[:, 4], image[:, 3]


@pytest.mark.parametrize("cap", ["0.999", "0.99"])
@pytest.mark.parametrize("case", [name for name in GOLDEN if name.startswith("N")])
@pytest.mark.parametrize("renderer", [TorchRenderer, CpuRenderer, warp])
def test_images_and_gradients(renderer: Any, case: str, cap: str) -> None:
    record = GOLDEN[case][f"cap_{cap}"]
    leaves = leaves_of(case)
    rgb, alpha, depth = accumulated(renderer(near=0.01, alpha_cap=float(cap)), leaves)
    assert_matches(rgb, record["rgb"], rtol=1e-4, atol=2e-5)
    assert_matches(alpha, record["alpha"], rtol=1e-4, atol=2e-5)
    if "depth" in record:
        assert_matches(depth, record["depth"], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(rgb.detach().mean(dim=(1, 2)), record["rgb_mean_per_camera"], rtol=1e-4)

    weights = [
        read(GOLDEN[case]["inputs"][name], tuple(image.shape))
        for name, image in zip(("w", "wd", "wa"), (rgb, depth, alpha), strict=True)
    ]
    loss = (rgb * weights[0]).sum() + 0.1 * (depth * weights[1]).sum() + (alpha * weights[2]).sum()
    assert loss.item() == pytest.approx(record["loss"], rel=2e-4)
    for name, gradient in zip(INPUTS, torch.autograd.grad(loss, leaves), strict=True):
        if "grads" not in record:
            assert gradient.norm().item() == pytest.approx(record["grad_l2"][name], rel=1e-3), name
            continue
        expected = record["grads"][name]
        assert gradient.norm().item() == pytest.approx(expected["l2"], rel=1e-3), name
        largest = max(abs(expected["min"]), abs(expected["max"]))
        samples = gradient.flatten()[expected["idx"]].double()
        torch.testing.assert_close(samples, torch.tensor(expected["val"]).double(), rtol=2e-3, atol=1e-4 * largest)


def garden() -> dict[str, np.ndarray]:
    with np.load(real("garden/test_garden.npz")) as data:
        return {name: data[name] for name in data.files}


@pytest.mark.parametrize("variant", [name for name in GOLDEN["garden"] if name.startswith("opacity")])
def test_real_points(variant: str) -> None:
    data = garden()
    _, opacity, _, cap = variant.split("_")
    about = GOLDEN["garden"]
    number = about["points"]
    intrinsics = torch.from_numpy(data["Ks"]).float()
    intrinsics[:, :2] /= 4
    pose = torch.linalg.inv(torch.from_numpy(data["viewmats"]).float())
    points = Gaussians(
        means=torch.from_numpy(data["means3d"]).float()[None],
        rotations=torch.tensor([1.0, 0, 0, 0]).expand(1, number, 4),
        scales=torch.full((1, number, 3), 0.01),
        opacities=torch.full((1, number), float(opacity)),
        harmonics=constant_from_rgb(torch.from_numpy(data["colors"]).float() / 255)[None, :, None],
    )
    renderer = CpuRenderer(near=0.01, alpha_cap=float(cap))
    image = renderer.accumulate(points, Cameras(pose[None], intrinsics[None], (about["H"], about["W"])))[0]
    for record in about[variant]:
        view = image[record["camera"]]
        assert_matches(view[:3].movedim(0, -1)[None], record["rgb"], rtol=1e-4, atol=5e-5)
        assert_matches(1 - view[None, 4], record["alpha"], rtol=1e-4, atol=5e-5)
        if "depth" in record:
            assert_matches(view[None, 3], record["depth"], rtol=1e-4, atol=2e-4)
