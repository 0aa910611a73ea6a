"""The examples in public docstrings give the results that they show."""

import doctest
import importlib

import pytest

MODULES = (
    "anystyle.evaluation.tables",
    "anystyle.geometry.harmonics",
    "anystyle.geometry.transforms",
    "anystyle.metrics.psnr",
    "anystyle.registry.build",
    "anystyle.registry.catalog",
    "anystyle.types.views",
    "anystyle_tiny.losses",
)


@pytest.mark.parametrize("module", MODULES)
def test_examples_are_right(module):
    result = doctest.testmod(importlib.import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0, f"{module} has no example"
    assert result.failed == 0
