"""The kinds of plugin that the core declares, and the built-in plugins of each."""

import tomllib
from pathlib import Path

BUILTIN: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""For each kind the built-in plugins by name, as ``module:Class``."""

KINDS = BUILTIN.pop("kind")
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
