"""Single-pass stylization of 3D Gaussian scenes, guided by text and images.

``stylizer = anystyle.load("tiny")``, ``scene = stylizer.encode(views)``,
``gaussians = stylizer.restyle(scene, stylizer.embed(text="..."))``,
``renders = stylizer.render(gaussians, scene.cameras)``, ``gaussians.save("scene.ply")``.

Names are imported when they are first asked for, so that ``import anystyle`` costs nothing.
"""

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from anystyle import types, weights
    from anystyle.registry.build import build
    from anystyle.registry.catalog import catalog, plugin
    from anystyle.stylizer import Stylizer

_HOMES = {
    "Stylizer": "anystyle.stylizer",
    "build": "anystyle.registry.build",
    "catalog": "anystyle.registry.catalog",
    "plugin": "anystyle.registry.catalog",
}


def load(model: str = "tiny", overrides: Sequence[str] = ()) -> "Stylizer":
    """Build a stylizer with its weights, ready for use: in ``eval`` mode, without gradients.

    Weights that are read from a file without a copy occupy memory only while their part of the network runs; see
    :func:`anystyle.paging.thrifty`.

    Args:
        model: A preset of ``conf/model``.
        overrides: In Hydra's grammar, as ``anystyle stylize`` takes them, such as ``renderer=gsplat``.

    Raises:
        ValueError: The preset or an override is unknown, or weights do not fit.
        FileNotFoundError: A file of weights is missing.
    """
    from anystyle.assemble import assemble
    from anystyle.paging import thrifty
    from anystyle.registry.compose import compose

    stylizer, _ = assemble(compose("stylize", [f"model={model}", *overrides]))
    stylizer = stylizer.requires_grad_(False).eval()
    thrifty(stylizer.stages)
    return stylizer


def __getattr__(name: str) -> Any:
    if name in ("types", "weights"):
        return importlib.import_module(f"anystyle.{name}")
    if name == "__version__":
        from importlib.metadata import version

        return version("anystyle")
    if name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'anystyle' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = ["Stylizer", "build", "catalog", "load", "plugin", "types", "weights"]
