"""The renderer that chooses another by the device of the tensors."""

import logging
from functools import cache

from anystyle.contracts import Renderer
from anystyle.registry.build import build
from anystyle.registry.catalog import PluginError, catalog
from anystyle.types import Cameras, Gaussians, Renders

_log = logging.getLogger(__name__)


class AutoRenderer(Renderer):
    """The renderer of the highest priority for the tensors' device: see :attr:`anystyle.contracts.Renderer.priority`.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are culled; the default is the published renderer's.
        far: Distance along z over which centres are culled.
        eps2d: Low-pass filter of a pixel: variance in pixels² added to every Gaussian in the image.
    """

    def __init__(
        self,
        *,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        near: float = 1e-10,
        far: float = 1e10,
        eps2d: float = 0.3,
    ) -> None:
        self.options = {"background": background, "near": near, "far": far, "eps2d": eps2d}
        self._renderers: dict[str, Renderer] = {}

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        device = gaussians.means.device.type
        if device not in self._renderers:
            plugin = catalog().find("renderer", best_renderer(device))
            self._renderers[device] = build(Renderer, {"_target_": plugin.path, **self.options})
        return self._renderers[device](gaussians, cameras)


@cache
def best_renderer(device: str) -> str:
    """The name of the renderer that ``auto`` takes for a type of device; decided once in a process."""
    ranks: list[tuple[int, str]] = []
    for name in catalog().names("renderer"):
        try:
            cls = catalog().find("renderer", name).load()
        except PluginError as error:
            _log.warning("renderer=auto skips %s: %s", name, error)
            continue
        assert issubclass(cls, Renderer)
        if cls.priority > 0 and (not cls.devices or device in cls.devices):
            ranks.append((-cls.priority, name))
    return min(ranks)[1]
