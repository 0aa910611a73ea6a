"""`anystyle plugins check` on bad plugins: each ends in a finding of its own, in plain words."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from anystyle.commands import plugins_check
from tests.support.program import program

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


def write(root: Path, name: str, kind: str, code: str, plugin: str | None = None) -> None:
    folder = root / name
    folder.mkdir()
    (folder / f"bad_{name}.py").write_text(IMPORTS + dedent(code))
    line = f'{plugin or name} = "bad_{name}:Mine"'
    (folder / "pyproject.toml").write_text(f'[project.entry-points."anystyle.{kind}"]\n{line}\n')


RUN = """
import sys
from anystyle.commands import plugins_check
for kind, name in zip(sys.argv[1::2], sys.argv[2::2]):
    print("=", name, plugins_check.main([kind, name]))
"""


@pytest.fixture(scope="module")
def reports(tmp_path_factory) -> dict[str, tuple[str, str]]:
    """The report on each bad plugin and its status, from a process in which nothing else checks types."""
    root = tmp_path_factory.mktemp("bad")
    for name, (kind, code, _) in BAD.items():
        write(root, name, kind, code)
    words = [word for name, (kind, *_) in BAD.items() for word in (kind, name)]
    environment = {**os.environ, "ANYSTYLE_PLUGINS": str(root)}
    done = subprocess.run([sys.executable, "-c", RUN, *words], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    reports: dict[str, tuple[str, str]] = {}
    lines: list[str] = []
    for line in done.stdout.splitlines():
        if line.startswith("= "):
            _, name, status = line.split()
            reports[name] = (status, "\n".join(lines))
            lines = []
        else:
            lines.append(line)
    return reports


@pytest.mark.parametrize("name", BAD)
def test_bad_plugin_has_a_finding_of_its_own(name, reports):
    kind, _, told = BAD[name]
    status, text = reports[name]
    assert status == "2"
    assert text.startswith(f"{kind} '{name}' (bad_{name}:Mine, declared by ") and told in " ".join(text.split())


def test_nothing_is_checked_after_what_is_needed(reports):
    assert reports["abstract"][1].splitlines()[-1].startswith("0 promises kept, 1 broken, 11 not checked, in ")


def test_a_good_plugin_ends_with_0(capsys):
    assert plugins_check.main(["placement", "head"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "placement 'head' (anystyle.placements:Head, declared by anystyle)"
    assert all(line.startswith("ok       ") for line in lines[1:-1])
    assert lines[-1].startswith(f"{len(lines) - 2} promises kept, in ")


def test_exit_statuses_reach_the_shell(tmp_path):
    write(tmp_path, "wordless", "placement", BAD["undescribed"][1])
    environment = {**os.environ, "ANYSTYLE_PLUGINS": str(tmp_path)}
    for name, status in (("wordless", 2), ("nobody", 2)):
        done = program(["plugins", "check", "placement", name], tmp_path, environment)
        assert done.status == status, done.out + done.err
        assert "Traceback" not in done.err
    assert done.err.startswith("anystyle: error: no placement is named 'nobody'.")
