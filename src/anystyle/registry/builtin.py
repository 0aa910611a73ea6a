"""The kinds of plugin that the core declares, and the built-in plugins of each."""

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
    "injector": Kind("anystyle.contracts:Injector", runtime=("dim", "style_dim", "site")),
    "renderer": Kind("anystyle.contracts:Renderer"),
    "cameras": Kind("anystyle.data.camera_reader:CameraReader"),
    "pose_estimator": Kind("anystyle.pipeline.poses:PoseEstimator"),
    "reconstruction": Kind("anystyle.contracts:Reconstruction"),
    "method": Kind("anystyle.methods.base:Method", runtime=("losses",)),
    "loss": Kind("anystyle.contracts:Loss", many=True, runtime=("style_encoder",)),
    "metric": Kind("anystyle.contracts:Metric", many=True, runtime=("style_encoder", "correspondence")),
    "correspondence": Kind("anystyle.contracts:Correspondence"),
    "scenes": Kind("anystyle.contracts:SceneSource", runtime=("resolution", "patch_size")),
    "styles": Kind("anystyle.contracts:StyleSource"),
    "training": Kind(
        "anystyle.training.base:Training",
        runtime=("backbone", "renderer", "style_encoder", "stylizer", "losses", "features"),
    ),
    "protocol": Kind(
        "anystyle.evaluation.base:Protocol", runtime=("stylizer", "method", "metrics", "scenes", "styles")
    ),
    "format": Kind("anystyle.contracts:Format", runtime=("activated", "renderer")),
    "command": Kind("anystyle.registry.socket:Command"),
}

OPTIONS = {
    "branch": "anystyle.pipeline.options:BranchOptions",
    "export": "anystyle.pipeline.options:ExportOptions",
    "splat": "anystyle.pipeline.options:SplatOptions",
    "trainer": "anystyle.training.trainer:TrainerOptions",
    "views": "anystyle.pipeline.options:ViewOptions",
}
"""Dataclasses of options that belong to no plugin, by their key in a configuration: ``options/KEY`` in a defaults list
puts one there with its defaults."""

BUILTIN: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""For each kind the built-in plugins by name, as ``module:Class``."""
