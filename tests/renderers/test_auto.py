"""The renderer that chooses another by the device."""

import pytest
import torch

from anystyle.contracts import Renderer
from anystyle.registry import catalog as registry
from anystyle.registry.catalog import Plugin, PluginError, catalog, plugin
from anystyle.renderers.auto import AutoRenderer, best_renderer
from anystyle.renderers.torch import TorchRenderer
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.scenes import cameras, gaussians


@pytest.fixture
def undecided(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(registry, "_OWN", {})
    best_renderer.cache_clear()
    yield
    best_renderer.cache_clear()


def test_it_renders_with_the_options_given() -> None:
    scene, views = gaussians(1, 100, 1), cameras(1, 2, (20, 30))
    options = {"background": (0.1, 0.2, 0.3), "near": 2.5, "far": 3.6, "eps2d": 0.5}
    assert torch.equal(AutoRenderer(**options)(scene, views).color, CpuRenderer(**options)(scene, views).color)


def test_devices_without_kernels_get_plain_pytorch() -> None:
    assert [best_renderer(device) for device in ("cpu", "cuda", "mps")] == ["cpu", "gsplat", "torch"]


def test_a_renderer_of_higher_priority_is_chosen_on_its_devices(undecided: None) -> None:
    class Mine(TorchRenderer):
        devices = ("cpu", "mps")
        priority = 11

    plugin("renderer", "mine")(Mine)
    assert [best_renderer(device) for device in ("cpu", "cuda", "mps")] == ["mine", "gsplat", "mine"]
    scene, views = gaussians(1, 20), cameras(1, 1, (8, 8))
    assert torch.equal(AutoRenderer()(scene, views).color, TorchRenderer()(scene, views).color)


def test_a_renderer_that_sets_no_priority_or_cannot_be_imported_is_not_chosen(
    undecided: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Mine(TorchRenderer):
        devices = ("cpu",)
        priority = 0

    plugin("renderer", "a_mine")(Mine)
    load = Plugin.load

    def broken(self: Plugin) -> type:
        if self.name == "gsplat":
            raise PluginError("it cannot be imported")
        return load(self)

    monkeypatch.setattr(Plugin, "load", broken)
    assert best_renderer("cpu") == "cpu" and best_renderer("cuda") == "torch"
    assert "renderer=auto skips gsplat" in caplog.text
    assert issubclass(catalog().find("renderer", "a_mine").load(), Renderer)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat needs a CUDA device")
def test_on_cuda() -> None:
    from anystyle.renderers.gsplat import GsplatRenderer

    scene, views = gaussians(1, 100).to("cuda"), cameras(1, 2, (20, 30)).to("cuda")
    assert torch.equal(AutoRenderer()(scene, views).color, GsplatRenderer()(scene, views).color)
