"""Single-pass stylization of 3D Gaussian scenes, guided by text and images.

``anystyle.stylize("photos/", "thick swirling strokes in deep blue", out="out/")`` does all of it. Step by step:
``stylizer = anystyle.load()``, ``scene = stylizer.encode(views)``,
``gaussians = stylizer.restyle(scene, stylizer.embed(text="..."))``,
``renders = stylizer.render(gaussians, scene.cameras)``, ``gaussians.save("scene.ply")``.

Names are imported when they are first asked for, so that ``import anystyle`` costs nothing.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

# Threads of OpenMP that spin while they wait cost several times the work where another program uses a core. Read when
# torch is imported; one's own setting is kept.
if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

if TYPE_CHECKING:
    from anystyle import types
    from anystyle.data.images import read_image
    from anystyle.evaluation.run import evaluate
    from anystyle.pipeline import weights
    from anystyle.pipeline.controls import Controls
    from anystyle.pipeline.load import load
    from anystyle.pipeline.options import ExportOptions, PoseOptions, SplatOptions, ViewOptions
    from anystyle.pipeline.request import Request
    from anystyle.pipeline.styles import Mixture, Named, Places
    from anystyle.pipeline.stylize import stylize
    from anystyle.registry.build import build
    from anystyle.registry.catalog import catalog, plugin
    from anystyle.stylizer import Stylizer
    from anystyle.training.run import train

_HOMES = {
    "data.images": ("read_image",),
    "evaluation.run": ("evaluate",),
    "pipeline.controls": ("Controls",),
    "pipeline.load": ("load",),
    "pipeline.options": ("ExportOptions", "PoseOptions", "SplatOptions", "ViewOptions"),
    "pipeline.request": ("Request",),
    "pipeline.styles": ("Mixture", "Named", "Places"),
    "pipeline.stylize": ("stylize",),
    "registry.build": ("build",),
    "registry.catalog": ("catalog", "plugin"),
    "stylizer": ("Stylizer",),
    "training.run": ("train",),
}


def __getattr__(name: str) -> Any:
    if name in ("types", "weights"):
        return importlib.import_module("anystyle.types" if name == "types" else "anystyle.pipeline.weights")
    if name == "__version__":
        from importlib.metadata import version

        return version("anystyle")
    for home, names in _HOMES.items():
        if name in names:
            globals()[name] = value = getattr(importlib.import_module(f"anystyle.{home}"), name)
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
    "Named",
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
