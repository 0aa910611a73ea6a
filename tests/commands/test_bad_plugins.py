"""Bad plugins in use, by the program as people start it: one line that says what is wrong with which, and status 2."""

import re
from collections import UserList
from contextlib import ExitStack

import numpy as np
import pytest

from anystyle.cli.run import name_plugin
from anystyle.registry.catalog import Plugin
from tests.support.bad_plugins import ends, write_plugin
from tests.support.pictures import save
from tests.support.program import Done

TOY = """
from dataclasses import replace

import torch

from anystyle.testing.toy.backbone import *

class Head(ToyGeometryHead):
    def forward(self, features, size):
        given = super().forward(features, size)
        return {result}

class Mine(ToyBackbone):
    "A backbone."
    def __init__(self, *, dim: int = 12) -> None:
        super().__init__(dim=dim, depth=2, patch_size=4)
        self.geometry_head = Head(dim=dim, patch_size=4)
"""
BAD = {
    "unannotated": (
        "from anystyle.contracts import Backbone\nclass Mine(Backbone):\n    def __init__(self, *, depth=3): ...",
        "does not annotate 'depth'; give it a type, as in 'depth: int = 2'",
    ),
    "keywords": (
        "from anystyle.contracts import Backbone\nclass Mine(Backbone):\n    def __init__(self, **options): ...",
        "takes '**options'; name and annotate every option",
    ),
    "wrong_shape": (
        TOY.format(result="replace(given, depth=given.depth[:, :, None])"),
        "given the backbone's `geometry_head`: Geometry.depth is float32 of shape [1, 1, 1, 56, 72]; expected "
        "floating-point numbers of shape [B=1, V=1, H=56, W=72]",
    ),
    "no_numbers": (
        TOY.format(result="replace(given, depth=given.depth * float('nan'))"),
        "numbers of the means of the unstyled scene are NaN or infinite",
    ),
}  # fmt: skip
"""Code, and what is said of it."""


WORDS = "stylize photo.png --text dots ~model backbone=mine views.short_side=56 video.frames=2"


@pytest.fixture(scope="module")
def ended(tmp_path_factory) -> dict[str, Done]:
    """How the program ends with each plugin."""
    root = tmp_path_factory.mktemp("bad")
    save(root / "photo.png", np.random.default_rng(0).integers(0, 255, (56, 72, 3), dtype=np.uint8))
    for name, (code, _) in BAD.items():
        write_plugin(root / name, "backbone", code, "mine")
    return ends(root, dict.fromkeys(BAD, WORDS))


class Idle:
    """A plugin that is not at work."""


class Broken(Idle):
    def forward(self):
        return helper()


class Kept(UserList):
    """A plugin whose base class raises."""


def helper():
    return [][0]


def unwind():
    """An error within another plugin's work."""
    with ExitStack() as stack:
        stack.callback(Kept().pop)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: Broken().forward(), r"loss 'broken' .*test_bad_plugins\.py, line \d+\); `anystyle plugins check loss"),
        (unwind, r"loss 'kept' .*`anystyle plugins check loss"),
        (helper, r"it was raised in the package tests \(test_bad_plugins\.py, line \d+\)\Z"),
    ],
)
def test_an_error_is_blamed_on_the_plugin_at_work(call, told, monkeypatch):
    rows = [Plugin("protocol", "stack", "contextlib:ExitStack", "the package lab")]
    for name in ("Idle", "Broken", "Kept"):
        rows.append(Plugin("loss", name.lower(), f"tests.commands:{name}", "the package lab"))
    monkeypatch.setattr("anystyle.registry.catalog.catalog", lambda: rows)
    with pytest.raises(IndexError) as caught:
        call()
    name_plugin(caught.value)
    (note,) = caught.value.__notes__
    assert re.match(told, note)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_backbone_ends_in_one_line_about_it(name, ended):
    status, _, errors = ended[name]
    assert status == 2, errors
    lines = (line for line in errors.splitlines() if not line.endswith("…"))
    (line,) = (line for line in lines if " is untrained and " not in line)
    assert line.startswith("anystyle: error: ") and BAD[name][1] in line
