"""The examples in public docstrings give the results that they show."""

import doctest
import importlib
import re
import sys
from dataclasses import replace

import pytest
import torch

from anystyle.registry.catalog import catalog
from anystyle.testing import inputs
from anystyle.types import Cameras, Comparison, Style

MODULES = (
    "anystyle.evaluation.names",
    "anystyle.evaluation.tables",
    "anystyle.geometry.harmonics",
    "anystyle.geometry.transforms",
    "anystyle.registry.build",
    "anystyle.registry.catalog",
    "anystyle.testing.oracle",
    "anystyle.types.network",
    "anystyle.vision.weights.table",
    "anystyle_tiny.losses",
)
SHARED = {
    "Cameras": Cameras,
    "Comparison": Comparison,
    "Style": Style,
    "inputs": inputs,
    "replace": replace,
    "torch": torch,
}
"""What examples of losses and metrics take for granted."""


@pytest.mark.parametrize("module", MODULES)
def test_examples_are_right(module):
    result = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0, f"{module} has no example"
    assert result.failed == 0


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in ("loss", "metric") for name in catalog().names(kind)]
)
def test_every_loss_and_metric_has_an_example_with_a_number(kind, name):
    cls = catalog().find(kind, name).load()
    known = vars(sys.modules[cls.__module__]) | SHARED
    example = doctest.DocTestParser().get_doctest(cls.__doc__, known, cls.__name__, None, None)
    assert any(re.search(r"\d", one.want) for one in example.examples), f"{cls.__name__} shows no number"
    torch.manual_seed(0)
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0
