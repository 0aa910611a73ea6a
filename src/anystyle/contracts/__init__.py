"""The contracts of plugins, one class for each kind; if you read one thing, read this folder, in this order.

1. :mod:`~anystyle.contracts.backbone`: the five parts of a feed-forward reconstruction network
2. :mod:`~anystyle.contracts.style`: style encoders, the injectors and placements by which style enters a network, and
   what predicts styled attributes
3. :mod:`~anystyle.contracts.cameras`: cameras that programs stored for photographs, and cameras that are estimated
4. :mod:`~anystyle.contracts.scene`: scenes and styles to learn from and to be judged on, reconstructions, methods by
   which a scene takes a style, and renderers
5. :mod:`~anystyle.contracts.scores`: losses, metrics and the correspondence of pixels
6. :mod:`~anystyle.contracts.training` and :mod:`~anystyle.contracts.protocol`: what learns, and how it is judged
7. :mod:`~anystyle.contracts.format` and :mod:`~anystyle.contracts.command`: files, and commands of the command line

A plugin inherits from one of these classes, implements its abstract methods and is listed in one line of TOML.
``anystyle.testing`` holds each contract as plain functions; ``anystyle plugins check`` runs them, on an instance built
with the options of :meth:`Pluggable.example <anystyle.registry.pluggable.Pluggable.example>`, the defaults unless
overridden. Names are imported when they are first asked for: a command needs no torch, and only trainings Lightning.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from anystyle.contracts.backbone import Adapter, Aggregator, Backbone, Embedder, GaussianHead, GeometryHead
    from anystyle.contracts.cameras import CameraReader, PosedViews, PoseEstimator, StoredCamera, Undistortion, Verdict
    from anystyle.contracts.command import Command
    from anystyle.contracts.format import Format
    from anystyle.contracts.protocol import Evaluation, Protocol, Row
    from anystyle.contracts.scene import LinearView, Method, Reconstruction, Renderer, SceneSource, StyleSource
    from anystyle.contracts.scores import Correspondence, Loss, Metric, accepts_tensors
    from anystyle.contracts.style import (
        Injector,
        Placement,
        StyleEncoder,
        StylePredictor,
        neutral_embedding,
        style_tokens,
    )
    from anystyle.contracts.training import BatchSource, Training
    from anystyle.registry.pluggable import Pluggable

_MODULES = ("command", "protocol", "scores", "style", "cameras", "backbone", "scene", "format", "training")


def __getattr__(name: str) -> Any:
    for module in _MODULES if name in __all__ else ():
        found = vars(importlib.import_module(f"{__name__}.{module}"))
        if name in found:
            return found[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "Adapter",
    "Aggregator",
    "Backbone",
    "BatchSource",
    "CameraReader",
    "Command",
    "Correspondence",
    "Embedder",
    "Evaluation",
    "Format",
    "GaussianHead",
    "GeometryHead",
    "Injector",
    "LinearView",
    "Loss",
    "Method",
    "Metric",
    "Placement",
    "Pluggable",
    "PoseEstimator",
    "PosedViews",
    "Protocol",
    "Reconstruction",
    "Renderer",
    "Row",
    "SceneSource",
    "StoredCamera",
    "StyleEncoder",
    "StylePredictor",
    "StyleSource",
    "Training",
    "Undistortion",
    "Verdict",
    "accepts_tensors",
    "neutral_embedding",
    "style_tokens",
]
