"""What is in the box: the kinds of plugin, and the built-in plugins of each."""

import tomllib
from pathlib import Path
from typing import NamedTuple


class Kind(NamedTuple):
    """A socket that plugins fit.

    Args:
        base: The contract, as ``module:Class``.
        many: Whether a configuration holds several at once.
        runtime: Constructor arguments that the framework passes by name, and that are no options.
    """

    base: str
    many: bool = False
    runtime: tuple[str, ...] = ()


KINDS: dict[str, Kind] = {
    "backbone": Kind("anystyle.contracts:Backbone"),
    "style_encoder": Kind("anystyle.contracts:StyleEncoder"),
    "placement": Kind("anystyle.contracts:Placement"),
    "injector": Kind("anystyle.contracts:Injector", runtime=("dim", "style_dim")),
    "renderer": Kind("anystyle.contracts:Renderer"),
    "reconstruction": Kind("anystyle.reconstructions.contract:Reconstruction"),
    "method": Kind("anystyle.methods.contract:Method", runtime=("losses",)),
    "loss": Kind("anystyle.contracts:Loss", many=True, runtime=("style_encoder",)),
    "metric": Kind("anystyle.contracts:Metric", many=True, runtime=("style_encoder", "correspondence")),
    "correspondence": Kind("anystyle.contracts:Correspondence"),
    "scenes": Kind("anystyle.contracts:SceneSource"),
    "styles": Kind("anystyle.contracts:StyleSource"),
    "study_test": Kind("anystyle.study.contract:StudyTest", many=True),
    "training": Kind(
        "anystyle.training.contract:Training",
        runtime=("backbone", "renderer", "style_encoder", "stylizer", "losses", "features"),
    ),
    "protocol": Kind(
        "anystyle.evaluation.contract:Protocol", runtime=("stylizer", "method", "metrics", "scenes", "styles")
    ),
}

BUILTIN: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""For each kind the built-in plugins by name, as ``module:Class``."""
