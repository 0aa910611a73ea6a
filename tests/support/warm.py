"""What commands import and read, done: processes that are forked from one that imports this begin at once."""

import importlib

from anystyle.compiled import compiled
from anystyle.registry.catalog import PluginError, catalog
from anystyle.registry.compose import compose

LIBRARIES = (
    *("torch", "lightning", "hydra", "torchmetrics", "kornia", "scipy.optimize", "scipy.stats", "matplotlib.pyplot"),
    *("anystyle.pipeline.load", "anystyle.training.run", "anystyle.training.stylization"),
    *("anystyle.evaluation.judge", "anystyle.evaluation.plots", "anystyle.testing.run", "anystyle_cpu_renderer"),
    *("anystyle.io.video", "anystyle_study.analysis"),
)

for name in LIBRARIES:
    importlib.import_module(name)
for plugin in catalog():
    try:
        plugin.load()
    except PluginError:  # of an extra that is not installed
        continue
for name in ("stylize", "train", "evaluate"):
    compose(name)


@compiled
def _nothing() -> None:
    """Compiling anything, or reading it back, loads the compiler."""


_nothing()
