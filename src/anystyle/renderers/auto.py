"""The renderer that chooses another by the device of the tensors."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import LinearView, Renderer
from anystyle.registry.build import build
from anystyle.registry.catalog import Plugin, PluginError, catalog
from anystyle.registry.packages import constant
from anystyle.renderers.rasterizer import RendererOptions
from anystyle.types import Cameras, Gaussians, Renders

_log = logging.getLogger(__name__)


@dataclass(kw_only=True, eq=False)
class AutoRenderer(RendererOptions, Renderer):
    """The renderer of the highest priority for the tensors' device, or where that is higher, for the CPU.

    The latter copies there and back, which is worth it: without kernels for an H200, plain PyTorch took 25 times as
    long there as the kernels of its host. A warning says so, and what to install.
    """

    def __post_init__(self) -> None:
        self._renderers: dict[str, Renderer] = {}

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        return self._best(gaussians)(gaussians, cameras)

    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView | None:
        return self._best(gaussians).linear_view(gaussians, camera)

    def _best(self, gaussians: Gaussians) -> Renderer:
        device = gaussians.means.device.type
        if device not in self._renderers:
            name, runs_on = best_renderer(device)
            renderer = build(Renderer, {"_target_": catalog().find("renderer", name).path, **asdict(self)})
            self._renderers[device] = renderer if runs_on == device else _OnCpu(renderer)
        return self._renderers[device]


@cache
def best_renderer(device: str) -> tuple[str, str]:
    """The renderer that ``auto`` takes for a type of device, and the type it runs on; decided once in a process."""
    ranked: list[tuple[int, bool, Plugin]] = []
    for name in catalog().names("renderer"):
        plugin = catalog().find("renderer", name)
        with _skipped(plugin):
            priority, devices = constant(plugin, "priority"), constant(plugin, "devices")
            fits = {on for on in (device, "cpu") if not devices or on in devices}
            ranked += [(priority, on == device, plugin) for on in fits if priority > 0]
    lacking = list[str]()
    for _, is_here, plugin in sorted(ranked, key=lambda each: (-each[0], not each[1])):
        with _skipped(plugin):
            if missing := plugin.load().lacks():
                lacking.append(f"{plugin.name} {missing}")
                continue
            if not is_here or lacking:
                place = f"on {device}" if is_here else f"on the CPU, with copies from {device} and back"
                why = "; ".join(lacking) or f"no faster renderer is for {device}"
                _log.warning("renderer=auto takes %s, %s: %s", plugin.name, place, why)
            return plugin.name, device if is_here else "cpu"
    raise PluginError(f"no renderer is for {device}")


class _OnCpu(Renderer):
    """A renderer of the CPU, for tensors of another device."""

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        return self.renderer(gaussians.to("cpu"), cameras.to("cpu")).to(gaussians.means.device)

    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView | None:
        view = self.renderer.linear_view(gaussians.to("cpu"), camera.to("cpu"))
        return None if view is None else _FromCpu(view, gaussians.means.device)


class _FromCpu(LinearView):
    """A linear view on the CPU, for tensors of another device."""

    def __init__(self, view: LinearView, device: torch.device) -> None:
        self.view, self.device, self.nbytes = view, device, view.nbytes
        self.background, self.render = view.background.to(device), view.render.to(device)

    def __call__(self, colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
        return self.view(colors.cpu()).to(self.device)

    def transposed(self, pixels: Float[Tensor, "3 H W"]) -> Float[Tensor, "N 3"]:
        return self.view.transposed(pixels.cpu()).to(self.device)


@contextmanager
def _skipped(plugin: Plugin) -> Iterator[None]:
    try:
        yield
    except PluginError as error:
        _log.warning("renderer=auto skips %s: %s", plugin.name, error)
