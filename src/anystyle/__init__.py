"""Single-pass stylization of 3D Gaussian scenes, guided by text and images.

``anystyle.stylize("photos/", "thick swirling strokes in deep blue", out="out/")`` does all of it. Step by step:
``stylizer = anystyle.load()``, ``scene = stylizer.encode(views)``,
``gaussians = stylizer.restyle(scene, stylizer.embed(text="..."))``,
``renders = stylizer.render(gaussians, scene.cameras)``, ``gaussians.save("scene.ply")``.

Names are imported when they are first asked for, so that ``import anystyle`` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from anystyle import types
    from anystyle.data.images import read_image
    from anystyle.evaluation.run import evaluate
    from anystyle.pipeline import weights
    from anystyle.pipeline.controls import Controls
    from anystyle.pipeline.load import load
    from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, ViewOptions
    from anystyle.pipeline.request import Request
    from anystyle.pipeline.styles import Mixture, Places
    from anystyle.pipeline.stylize import stylize
    from anystyle.registry.build import build
    from anystyle.registry.catalog import catalog, plugin
    from anystyle.stylizer import Stylizer
    from anystyle.training.run import train

_MODULES = {"types": "anystyle.types", "weights": "anystyle.pipeline.weights"}
_HOMES = {
    "Controls": "anystyle.pipeline.controls",
    "ExportOptions": "anystyle.pipeline.options",
    "Mixture": "anystyle.pipeline.styles",
    "Places": "anystyle.pipeline.styles",
    "PoseOptions": "anystyle.pipeline.options",
    "Request": "anystyle.pipeline.request",
    "SplatOptions": "anystyle.pipeline.options",
    "Stylizer": "anystyle.stylizer",
    "ViewOptions": "anystyle.pipeline.options",
    "build": "anystyle.registry.build",
    "catalog": "anystyle.registry.catalog",
    "evaluate": "anystyle.evaluation.run",
    "load": "anystyle.pipeline.load",
    "plugin": "anystyle.registry.catalog",
    "read_image": "anystyle.data.images",
    "stylize": "anystyle.pipeline.stylize",
    "train": "anystyle.training.run",
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    if name == "__version__":
        from importlib.metadata import version

        return version("anystyle")
    if name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    if name == "VideoOptions":
        raise AttributeError("VideoOptions is gone: give stylize a mapping, such as video={'frames': 48}")
    raise AttributeError(f"module 'anystyle' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    "Controls",
    "ExportOptions",
    "Mixture",
    "Places",
    "PoseOptions",
    "Request",
    "SplatOptions",
    "Stylizer",
    "ViewOptions",
    "build",
    "catalog",
    "evaluate",
    "load",
    "plugin",
    "read_image",
    "stylize",
    "train",
    "types",
    "weights",
]
