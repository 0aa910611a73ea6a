"""The renderer that goes where the tensors are."""

import pytest
import torch

from anystyle.renderers.auto import AutoRenderer
from anystyle.renderers.cpu.renderer import CpuRenderer
from anystyle.renderers.torch import TorchRenderer
from renderers.scenes import cameras, gaussians


def test_on_the_cpu() -> None:
    scene, views = gaussians(1, 100, 1), cameras(1, 2, (20, 30))
    options = {"background": (0.1, 0.2, 0.3), "near": 2.5, "far": 3.6, "eps2d": 0.5}
    assert torch.equal(AutoRenderer(**options)(scene, views).color, CpuRenderer(**options)(scene, views).color)


def test_elsewhere_it_needs_no_kernels() -> None:
    """A device without kernels of its own gets the renderer in plain PyTorch, which alone takes such tensors."""
    scene, views = gaussians(1, 5).to("meta"), cameras(1, 1, (4, 4)).to("meta")
    with pytest.raises(RuntimeError) as expected:  # a meta tensor has no number of visible Gaussians
        TorchRenderer()(scene, views)
    with pytest.raises(type(expected.value)):
        AutoRenderer()(scene, views)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat needs a CUDA device")
def test_on_cuda() -> None:
    from anystyle.renderers.gsplat import GsplatRenderer

    scene, views = gaussians(1, 100).to("cuda"), cameras(1, 2, (20, 30)).to("cuda")
    assert torch.equal(AutoRenderer()(scene, views).color, GsplatRenderer()(scene, views).color)
