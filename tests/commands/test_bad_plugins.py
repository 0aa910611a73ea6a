"""Bad plugins in use, by the program as people start it: one line that says what is wrong with which, and status 2."""

import os
from textwrap import dedent

import numpy as np
import pytest
from PIL import Image

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


@pytest.fixture(scope="module")
def use(tmp_path_factory, program):
    """Run commands in a folder with a photograph, where ``ANYSTYLE_PLUGINS`` is a folder of one plugin."""
    root = tmp_path_factory.mktemp("bad")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (56, 72, 3), dtype=np.uint8)).save(root / "photo.png")

    def run(name, code, *words):
        folder = root / name / "plugin"
        folder.mkdir(parents=True)
        (folder / f"bad_{name}.py").write_text(dedent(code))
        line = f'mine = "bad_{name}:Mine"'
        (folder / "pyproject.toml").write_text(f'[project.entry-points."anystyle.backbone"]\n{line}\n')
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "ANYSTYLE_PLUGINS": str(root / name)}
        environment.pop("ANYSTYLE_TRACEBACK", None)
        return program(list(words), folder=root, environment=environment)

    return run


WORDS = ("stylize", "photo.png", "--text", "dots", "~model", "backbone=mine", "views.short_side=56", "video.frames=2")


@pytest.mark.parametrize("name", BAD)
def test_a_bad_backbone_ends_in_one_line_about_it(name, use):
    code, told = BAD[name]
    done = use(name, code, *WORDS)
    assert done.status == 2, done.err
    lines = (line for line in done.err.splitlines() if not line.endswith("…"))
    (line,) = (line for line in lines if " is untrained and " not in line)
    assert line.startswith("anystyle: error: ") and told in line
