"""Bad plugins in use, by the program as people start it: one line that says what is wrong with which, and status 2."""

import json
import re
import subprocess
import sys
from collections import UserList
from contextlib import ExitStack
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
from PIL import Image

from anystyle.cli.run import name_plugin
from anystyle.registry.catalog import Plugin

ROOT = Path(__file__).parents[2]
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


RUN = """
import json, os, sys
from pathlib import Path
from tests.support.program import program
root, words, *names = sys.argv[1:]
ended = {}
for name in names:
    done = program(words.split(), Path(root), {**os.environ, "ANYSTYLE_PLUGINS": str(Path(root, name))})
    ended[name] = done.status, done.err
print(json.dumps(ended))
"""
WORDS = "stylize photo.png --text dots ~model backbone=mine views.short_side=56 video.frames=2"


@pytest.fixture(scope="module")
def ended(tmp_path_factory) -> dict[str, tuple[int, str]]:
    """The status and the errors of the program with each plugin, in a process in which nothing else checks types."""
    root = tmp_path_factory.mktemp("bad")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (56, 72, 3), dtype=np.uint8)).save(root / "photo.png")
    for name, (code, _) in BAD.items():
        folder = root / name / "plugin"
        folder.mkdir(parents=True)
        (folder / f"bad_{name}.py").write_text(dedent(code))
        line = f'mine = "bad_{name}:Mine"'
        (folder / "pyproject.toml").write_text(f'[project.entry-points."anystyle.backbone"]\n{line}\n')
    command = [sys.executable, "-c", RUN, str(root), WORDS, *BAD]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


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
    status, errors = ended[name]
    assert status == 2, errors
    lines = (line for line in errors.splitlines() if not line.endswith("…"))
    (line,) = (line for line in lines if " is untrained and " not in line)
    assert line.startswith("anystyle: error: ") and BAD[name][1] in line
