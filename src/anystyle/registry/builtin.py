"""The kinds of plugin that the core declares, and the built-in plugins of each."""

import tomllib
from pathlib import Path

KINDS = {
    kind: f"anystyle.contracts.{contract}"
    for kind, contract in {
        "backbone": "backbone:Backbone",
        "style_encoder": "style:StyleEncoder",
        "placement": "style:Placement",
        "injector": "style:Injector",
        "renderer": "scene:Renderer",
        "cameras": "cameras:CameraReader",
        "pose_estimator": "cameras:PoseEstimator",
        "reconstruction": "scene:Reconstruction",
        "method": "scene:Method",
        "loss": "scores:Loss",
        "metric": "scores:Metric",
        "correspondence": "scores:Correspondence",
        "scenes": "scene:SceneSource",
        "styles": "scene:StyleSource",
        "training": "training:Training",
        "protocol": "protocol:Protocol",
        "format": "format:Format",
        "command": "command:Command",
    }.items()
}
"""For each kind its contract, as ``module:Class``."""

MANY = ("loss", "metric")
"""Those of which a configuration holds several at once, as their contracts say, too."""

OPTIONS = {
    "branch": "anystyle.pipeline.options:BranchOptions",
    "export": "anystyle.pipeline.options:ExportOptions",
    "splat": "anystyle.pipeline.options:SplatOptions",
    "trainer": "anystyle.training.trainer:TrainerOptions",
    "video": "anystyle.pipeline.options:VideoOptions",
    "views": "anystyle.pipeline.options:ViewOptions",
}
"""Dataclasses of options that belong to no plugin, by their key in a configuration: ``options/KEY`` in a defaults list
puts one there with its defaults."""

BUILTIN: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""For each kind the built-in plugins by name, as ``module:Class``."""
