"""The renderer that chooses another by the device of the tensors."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache

from anystyle.contracts import LinearView, Renderer
from anystyle.registry.build import build
from anystyle.registry.catalog import Plugin, PluginError, catalog
from anystyle.registry.packages import constant
from anystyle.renderers.rasterizer import RendererOptions
from anystyle.types import Cameras, Gaussians, Renders

_log = logging.getLogger(__name__)


@dataclass(kw_only=True, eq=False)
class AutoRenderer(RendererOptions, Renderer):
    """The renderer of the highest priority for the tensors' device."""

    def __post_init__(self) -> None:
        self._renderers: dict[str, Renderer] = {}

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        return self._best(gaussians)(gaussians, cameras)

    def linear_view(self, gaussians: Gaussians, camera: Cameras) -> LinearView | None:
        return self._best(gaussians).linear_view(gaussians, camera)

    def _best(self, gaussians: Gaussians) -> Renderer:
        device = gaussians.means.device.type
        if device not in self._renderers:
            plugin = catalog().find("renderer", best_renderer(device))
            self._renderers[device] = build(Renderer, {"_target_": plugin.path, **asdict(self)})
        return self._renderers[device]


@cache
def best_renderer(device: str) -> str:
    """The name of the renderer that ``auto`` takes for a type of device; decided once in a process."""
    plugins = [catalog().find("renderer", name) for name in catalog().names("renderer")]
    ranked: list[tuple[int, Plugin]] = []
    for plugin in plugins:
        with _skipped(plugin):
            ranked.append((constant(plugin, "priority"), plugin))
    for priority, plugin in sorted(ranked, key=lambda each: -each[0]):
        with _skipped(plugin):
            devices = constant(plugin, "devices")
            if priority > 0 and (not devices or device in devices):
                plugin.load()
                return plugin.name
    raise PluginError(f"no renderer is for {device}")


@contextmanager
def _skipped(plugin: Plugin) -> Iterator[None]:
    try:
        yield
    except PluginError as error:
        _log.warning("renderer=auto skips %s: %s", plugin.name, error)
