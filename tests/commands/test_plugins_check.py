"""`anystyle plugins check` on bad plugins: each ends in a finding of its own, in plain words."""

import json
import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from anystyle.commands import plugins_check
from anystyle.errors import UserError

TOY = "from anystyle.testing.toy.backbone import *\nfrom dataclasses import replace\nimport torch\n"
HEAD = """
class Head(ToyGeometryHead):
    def forward(self, features, size):
        given = super().forward(features, size)
        return {result}

class Mine(ToyBackbone):
    "A backbone."
    def __init__(self, *, dim: int = 12) -> None:
        super().__init__(dim=dim, depth=2, patch_size=4)
        self.geometry_head = Head(dim=dim, patch_size=4)

    @classmethod
    def example(cls, folder):
        return {{}}
"""

BAD = {
    "unannotated": (
        "placement",
        """
        from anystyle.contracts import Placement
        class Mine(Placement):
            "A placement."
            def __init__(self, *, depth=3): ...
            def select(self, sites): return tuple(sites)
        """,
        ["options can be checked"],
        "does not annotate 'depth'",
    ),
    "keywords": (
        "placement",
        """
        from anystyle.contracts import Placement
        class Mine(Placement):
            "A placement."
            def __init__(self, **options): ...
            def select(self, sites): return tuple(sites)
        """,
        ["options can be checked"],
        "takes '**options'",
    ),
    "wrong_base": (
        "backbone",
        "import torch\nclass Mine(torch.nn.Module):\n    'No backbone.'\n",
        ["class can be imported"],
        "must inherit from anystyle.contracts.Backbone",
    ),
    "import_error": (
        "backbone",
        "import torch\nfrom does_not_exist import Trunk\nclass Mine: ...\n",
        ["class can be imported"],
        "No module named 'does_not_exist'",
    ),
    "syntax_error": (
        "backbone",
        "class Mine(:\n",
        ["class can be imported"],
        "invalid syntax",
    ),
    "no_such_class": (
        "backbone",
        "class Yours: ...\n",
        ["class can be imported"],
        "has no attribute 'Mine'",
    ),
    "abstract": (
        "renderer",
        "from anystyle.contracts import Renderer\nclass Mine(Renderer):\n    'A renderer.'\n",
        ["every method is there"],
        "Mine lacks __call__",
    ),
    "undescribed": (
        "placement",
        """
        from anystyle.contracts import Placement
        class Mine(Placement):
            def select(self, sites):
                if not sites: raise ValueError("no site is left")
                return tuple(sites)
        """,
        ["first line describes it"],
        "Mine without a docstring",
    ),
    "strange_example": (
        "placement",
        """
        from anystyle.testing.toy.placement import *
        class Mine(ToyPlacement):
            "A placement."
            @classmethod
            def example(cls, folder): return {"num_site": 3}
        """,
        ["example fits the options"],
        "'num_site'",
    ),
    "broken_constructor": (
        "placement",
        """
        from anystyle.testing.toy.placement import *
        class Mine(ToyPlacement):
            "A placement."
            def __init__(self, *, num_sites: int = 2) -> None:
                raise RuntimeError("no such file: sites.json")
        """,
        ["selects sites of the backbone"],
        "Mine() ended in RuntimeError: no such file: sites.json (",
    ),
    "needs_a_package": (
        "placement",
        """
        from anystyle.testing.toy.placement import *
        class Mine(ToyPlacement):
            "A placement."
            def __init__(self, *, num_sites: int = 2) -> None:
                raise ImportError('this placement needs foo: pip install "acme[foo]"')
        """,
        [],
        'not checked (it cannot be checked here: this placement needs foo: pip install "acme[foo]")',
    ),
    "full_size": (
        "backbone",
        TOY
        + """
class Mine(ToyBackbone):
    "A backbone."
    def __init__(self, *, dim: int = 4096) -> None:
        super().__init__(dim=dim, depth=24, patch_size=14)
    @classmethod
    def example(cls, folder):
        return {}
""",
        ["all five parts are there"],
        "a network of more than 32,000,000 parameters",
    ),
    "wrong_shape": (
        "backbone",
        TOY + HEAD.format(result="replace(given, depth=given.depth[:, :, None])"),
        ["encodes two views"],
        "Geometry.depth is float32 of shape [1, 2, 1, 12, 12]",
    ),
    "wrong_dtype": (
        "backbone",
        TOY + HEAD.format(result="replace(given, depth=given.depth.int())"),
        ["encodes two views"],
        "Geometry.depth is int32 of shape [1, 2, 12, 12]",
    ),
    "half_precision": (
        "backbone",
        TOY + HEAD.format(result="replace(given, confidence=given.confidence.half())"),
        ["dtypes are kept"],
        "`geometry.confidence` is float16 of shape [1, 2, 12, 12]",
    ),
    "no_numbers": (
        "backbone",
        TOY + HEAD.format(result="replace(given, confidence=given.confidence * float('nan'))"),
        ["numbers are finite"],
        "288 of the 288 numbers of `geometry` (confidence) are NaN or infinite",
    ),
    "one_view": (
        "backbone",
        TOY + HEAD.format(result="replace(given, depth=given.depth + given.depth.flatten(2)[:, 1, :1, None, None])"),
        ["encodes a single view"],
        "`encode` of 1 scene(s), 1 view(s) of 12x12 pixels ended in IndexError",
    ),
    "many_scenes": (
        "backbone",
        TOY + HEAD.format(result="replace(given, depth=given.depth + 0.3 * given.depth.mean(0))"),
        ["encodes several scenes at once"],
        "`geometry` of scene 0 of a batch of two against the same scene alone (depth)",
    ),
    "not_square": (
        "backbone",
        TOY + HEAD.format(result="replace(given, depth=given.depth + 0 * given.depth.mT)"),
        ["encodes every shape"],
        "`encode` of 1 scene(s), 2 view(s) of 8x12 pixels ended in RuntimeError",
    ),
    "not_the_identity": (
        "injector",
        """
        from anystyle.testing.toy.injector import *
        class Mine(ToyInjector):
            "An injector."
            def __init__(self, *, dim: int, style_dim: int) -> None:
                super().__init__(dim=dim, style_dim=style_dim)
                nn.init.normal_(self.scale.weight, std=1e-3)
        """,
        ["changes nothing at birth"],
        "tokens after an untrained injector (seed 0, 0 special tokens)",
    ),
}

RUN = """
import contextlib, io, json, sys
from anystyle.commands import plugins_check
found = {}
for kind, name in json.loads(sys.argv[1]):
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = plugins_check.main([kind, name])
    found[name] = {"status": status, "text": out.getvalue()}
json.dump(found, sys.stdout)
"""


def _write(root: Path, name: str, kind: str, code: str, plugin: str | None = None) -> None:
    folder = root / name
    folder.mkdir()
    (folder / f"bad_{name}.py").write_text(dedent(code))
    line = f'{plugin or name} = "bad_{name}:Mine"'
    (folder / "pyproject.toml").write_text(f'[project.entry-points."anystyle.{kind}"]\n{line}\n')


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, dict]:
    """The report on each bad plugin. In a process of its own: there, as for users, nothing else checks types."""
    root = tmp_path_factory.mktemp("bad")
    for name, (kind, code, _, _) in BAD.items():
        _write(root, name, kind, code)
    _write(root, "twins_one", "placement", BAD["undescribed"][1], plugin="twins")
    _write(root, "twins_other", "placement", BAD["undescribed"][1], plugin="twins")
    asked = [(kind, name) for name, (kind, *_) in BAD.items()] + [("placement", "twins")]
    environment = {**os.environ, "ANYSTYLE_PLUGINS": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", RUN, json.dumps(asked)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", BAD)
def test_bad_plugin_has_a_finding_of_its_own(name, found):
    kind, _, broken, told = BAD[name]
    text = found[name]["text"]
    assert found[name]["status"] == 1
    assert text.startswith(f"{kind} '{name}' (bad_{name}:Mine, declared by ")
    assert [line.removeprefix("BROKEN  ") for line in text.splitlines() if line.startswith("BROKEN")] == broken
    assert told in " ".join(text.split())
    for word in ("given", "expected", "change"):
        assert sum(line.startswith(f"  {word} ") for line in text.splitlines()) == len(broken)


def test_two_plugins_of_one_name(found):
    text = " ".join(found["twins"]["text"].split())
    assert found["twins"]["status"] == 1
    assert "BROKEN name is declared once given 2 declarations: placement 'twins' (bad_twins_one:Mine" in text
    assert "rename one of them in its pyproject.toml" in text


def test_nothing_is_checked_after_what_is_needed(found):
    text = found["wrong_base"]["text"]
    assert text.rstrip().splitlines()[-1].startswith("1 promise kept, 1 broken, ")
    assert "not checked (needs what 'class can be imported' promises)" in text


def test_hints_show_the_promise_and_code_that_keeps_it(tmp_path, monkeypatch, capsys):
    _write(tmp_path, "hinted", "placement", BAD["undescribed"][1].replace("tuple(sites)", "list(sites)"))
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path))
    monkeypatch.setattr("sys.path", list(sys.path))
    assert plugins_check.main(["placement", "hinted"]) == 1
    plain = capsys.readouterr().out
    assert plugins_check.main(["placement", "hinted", "--fix-hints"]) == 1
    hinted = capsys.readouterr().out
    assert "  promise   " not in plain
    assert "  promise   It selects at least one of a usual backbone's sites" in hinted
    assert "bad_hinted.py, line 3" in " ".join(hinted.split())
    assert "class ToyPlacement(Placement):" in hinted
    assert len(hinted) > 2 * len(plain)


def test_a_good_plugin_ends_with_0(capsys):
    assert plugins_check.main(["placement", "head"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("placement 'head' (anystyle.placements.head:Head, declared by anystyle)\n")
    assert "BROKEN" not in shown
    assert "promises kept, in" in shown


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["placement", "haed"], "no placement is named 'haed'. Did you mean 'head'?"),
        (["placements", "head"], "no kind of plugin is named 'placements'. Did you mean 'placement'?"),
        (["placement"], "the following arguments are required: NAME"),
        (["placement", "head", "--fix-hint"], "Did you mean '--fix-hints'?"),
    ],
)
def test_what_is_asked_for_must_exist(words, told):
    with pytest.raises(UserError) as caught:
        plugins_check.main(words)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_exit_statuses_reach_the_shell(tmp_path, program):
    _write(tmp_path, "wordless", "placement", BAD["undescribed"][1])
    environment = {**os.environ, "ANYSTYLE_PLUGINS": str(tmp_path)}
    for name, status in (("wordless", 1), ("nobody", 2)):
        done = program(["plugins", "check", "placement", name], folder=tmp_path, environment=environment)
        assert done.status == status, done.out + done.err
        assert "Traceback" not in done.err
    assert done.err.startswith("anystyle: error: no placement is named 'nobody'.")
