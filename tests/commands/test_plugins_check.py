"""`anystyle plugins check` on bad plugins: each ends in a finding of its own, in plain words."""

import os

import pytest

from anystyle.commands import plugins_check
from tests.support.bad_plugins import ends, write_plugin
from tests.support.program import Done, program

IMPORTS = """
from dataclasses import replace
import torch
from torch import nn
from anystyle.errors import MissingExtra
from anystyle.contracts import Placement, Renderer
from anystyle.testing.toy.backbone import *
from anystyle.testing.toy.injector import ToyInjector
from anystyle.testing.toy.placement import ToyPlacement
"""
HEAD = """
class Head(ToyGeometryHead):
    def forward(self, features, images):
        given = super().forward(features, images)
        return replace(given, {field})

class Mine(ToyBackbone):
    "A backbone."
    def __init__(self, *, dim: int = 12) -> None:
        super().__init__(dim=dim, depth=2, patch_size=4)
        self.geometry_head = Head(dim=dim, patch_size=4)

    @classmethod
    def example(cls, folder):
        return {{}}
"""
PLACEMENT = """
class Mine(ToyPlacement):
    "A placement."
    {body}
"""

BAD = {
    # ruff: noqa: E501
    "abstract": ("renderer", "class Mine(Renderer):\n    'A renderer.'\n", "Mine lacks __call__"),
    "undescribed": ("placement", "class Mine(ToyPlacement): ...\n", "Mine without a docstring"),
    "unannotated": (
        "placement",
        PLACEMENT.format(body="def __init__(self, *, depth=3): ..."),
        "placement 'unannotated' (bad_unannotated:Mine, declared by bad_unannotated) does not annotate 'depth'",
    ),
    "broken_constructor": (
        "placement",
        PLACEMENT.format(body="def __init__(self): raise RuntimeError('no such file: sites.json')"),
        "RuntimeError: no such file: sites.json (bad_broken_constructor.py, line ",
    ),
    "needs_a_package": (
        "placement",
        PLACEMENT.format(body="def __init__(self): raise MissingExtra('it needs foo: pip install \"acme[foo]\"')"),
        'it cannot be checked here: it needs foo: pip install "acme[foo]"',
    ),
    "full_size": (
        "backbone",
        "class Mine(ToyBackbone):\n    'A backbone.'\n    def __init__(self, *, dim: int = 1024) -> None:\n"
        "        super().__init__(dim=dim, depth=24, patch_size=14)\n"
        "    example = classmethod(lambda cls, folder: {})\n",
        "a network of more than 32,000,000 parameters",
    ),
    "half_precision": (
        "backbone",
        HEAD.format(field="confidence=given.confidence.half()"),
        "`0.confidence` is torch.float16",
    ),
    "not_the_identity": (
        "injector",
        "class Mine(ToyInjector):\n    'An injector.'\n    def __init__(self, *, dim: int, style_dim: int) -> None:\n"
        "        super().__init__(dim=dim, style_dim=style_dim)\n        nn.init.normal_(self.scale.weight, std=1e-3)\n",
        "tokens after an untrained injector (0 special tokens)",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def reports(tmp_path_factory) -> dict[str, Done]:
    """How the check of each bad plugin ends."""
    root = tmp_path_factory.mktemp("bad")
    for name, (kind, code, _) in BAD.items():
        write_plugin(root / name, kind, IMPORTS + code, name)
    return ends(root, {name: f"plugins check {kind} {name}" for name, (kind, *_) in BAD.items()})


@pytest.mark.parametrize("name", BAD)
def test_bad_plugin_has_a_finding_of_its_own(name, reports):
    kind, _, told = BAD[name]
    status, text, errors = reports[name]
    assert status == 2 and "Traceback" not in errors
    assert text.startswith(f"{kind} '{name}' (bad_{name}:Mine, declared by ") and told in " ".join(text.split())


def test_nothing_is_checked_after_what_is_needed(reports):
    assert reports["abstract"].out.splitlines()[-1].startswith("0 promises kept, 1 broken, 11 not checked, in ")


def test_a_good_plugin_ends_with_0(capsys):
    assert plugins_check.main(["placement", "head"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "placement 'head' (anystyle.placements:Head, declared by anystyle)"
    assert all(line.startswith("ok       ") for line in lines[1:-1])
    assert lines[-1].startswith(f"{len(lines) - 2} promises kept, in ")


def test_a_plugin_that_nobody_declares_is_told(tmp_path):
    done = program(["plugins", "check", "placement", "nobody"], tmp_path, os.environ)
    assert done.status == 2 and done.err.startswith("anystyle: error: no placement is named 'nobody'.")
