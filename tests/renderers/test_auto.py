"""The renderer that chooses another by the device."""

from importlib.util import find_spec

import pytest
import torch

from anystyle.contracts import Renderer
from anystyle.registry import catalog as registry
from anystyle.registry.catalog import Plugin, PluginError, catalog, plugin
from anystyle.renderers.auto import AutoRenderer, best_renderer
from anystyle.renderers.gsplat import GsplatRenderer
from anystyle.renderers.torch import TorchRenderer
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.elsewhere import There, elsewhere
from tests.support.scenes import cameras, gaussians, warp


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


def test_devices_without_kernels_are_served_by_the_cpu(undecided: None, caplog: pytest.LogCaptureFixture) -> None:
    assert best_renderer("cpu") == ("cpu", "cpu") and not caplog.text and best_renderer("mps") == ("cpu", "cpu")
    assert "takes cpu, on the CPU, with copies from mps and back: no faster renderer is for mps" in caplog.text


@pytest.mark.parametrize(
    ("missing", "expected", "told"),
    [
        ([], ("gsplat", "cuda"), ""),
        (["gsplat"], ("warp", "cuda"), "takes warp, on cuda: gsplat is not installed"),
        (["gsplat", "warp"], ("cpu", "cpu"), "takes cpu, on the CPU, with copies from cuda and back: gsplat is not"),
    ],
)
def test_a_card_without_gsplat_is_no_trap(undecided: None, monkeypatch, caplog, missing, expected, told) -> None:
    for name, renderer in (("gsplat", GsplatRenderer), ("warp", warp.values[0])):
        lacks = classmethod(lambda cls, it=name: "is not installed: pip install it" if it in missing else None)
        monkeypatch.setattr(renderer, "lacks", lacks)
    assert best_renderer("cuda") == expected and told in caplog.text and len(caplog.records) == bool(missing)
    assert all(f"{name} is not installed: pip install it" in caplog.text for name in missing)


@pytest.mark.skipif(find_spec("gsplat") is not None, reason="gsplat is installed")
def test_what_gsplat_lacks_is_named() -> None:
    assert GsplatRenderer.lacks() == 'is not installed: pip install "anystyle[gpu]"' and CpuRenderer.lacks() is None


def test_tensors_of_another_device_are_rendered_on_the_cpu_and_stay_there(undecided: None) -> None:
    scene, views, expected = gaussians(1, 50), cameras(1, 2, (20, 30)), CpuRenderer()
    given, pixels = torch.rand(50, 3), torch.rand(3, 20, 30)
    view = expected.linear_view(scene, views.select([0]))
    with torch.no_grad(), elsewhere() as device:
        renders = AutoRenderer()(scene.to(device), views.to(device))
        assert isinstance(renders.color, There) and torch.equal(renders.color.inner, expected(scene, views).color)
        there = AutoRenderer().linear_view(scene.to(device), views.select([0]).to(device))
        assert there is not None and isinstance(there.background, There)
        for result, value in (
            (there(given.to(device)), view(given)),
            (there.transposed(pixels.to(device)), view.transposed(pixels)),
        ):
            assert isinstance(result, There) and torch.equal(result.inner, value)


def test_a_renderer_of_higher_priority_is_chosen_on_its_devices(undecided: None, monkeypatch) -> None:
    class Mine(TorchRenderer):
        devices = ("cpu", "mps")
        priority = 11

    monkeypatch.setattr(GsplatRenderer, "lacks", classmethod(lambda cls: None))
    plugin("renderer", "mine")(Mine)
    assert [best_renderer(device) for device in ("cpu", "mps")] == [("mine", "cpu"), ("mine", "mps")]
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
        if self.name in ("gsplat", "cpu", "warp"):
            raise PluginError("it cannot be imported")
        return load(self)

    monkeypatch.setattr(Plugin, "load", broken)
    assert best_renderer("cpu") == ("torch", "cpu") and best_renderer("cuda") == ("torch", "cuda")
    assert "renderer=auto skips gsplat" in caplog.text
    assert issubclass(catalog().find("renderer", "a_mine").load(), Renderer)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat needs a CUDA device")
def test_on_cuda() -> None:
    scene, views = gaussians(1, 100).to("cuda"), cameras(1, 2, (20, 30)).to("cuda")
    assert torch.equal(AutoRenderer()(scene, views).color, GsplatRenderer()(scene, views).color)
