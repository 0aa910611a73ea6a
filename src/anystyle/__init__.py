"""Single-pass stylization of 3D Gaussian scenes, guided by text and images.

``anystyle.stylize("photos/", "thick swirling strokes in deep blue", out="out/")`` does all of it. Step by step:
``stylizer = anystyle.load()``, ``scene = stylizer.encode(views)``,
``gaussians = stylizer.restyle(scene, stylizer.embed(text="..."))``,
``renders = stylizer.render(gaussians, scene.cameras)``, ``gaussians.save("scene.ply")``.

Names are imported when they are first asked for, so that ``import anystyle`` costs nothing.
"""

import importlib
import os
from typing import Any

from anystyle import lazy

# Threads of OpenMP that spin while they wait cost several times the work where another program uses a core. Read when
# torch is imported; one's own setting is kept.
if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_named, __dir__, __all__ = lazy.stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "weights":
        return importlib.import_module("anystyle.pipeline.weights")
    if name == "__version__":
        from importlib.metadata import version

        return version("anystyle")
    return _named(name)
