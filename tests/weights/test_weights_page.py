"""``docs/weights.md``: its program runs, its table is whole; its commands are run by tests/docs/test_commands.py."""

import re
from pathlib import Path

import pytest
import torch

from anystyle.vision import weights
from tests.support.docs_cases import ROOT, blocks
from tests.support.weights_cases import training_checkpoint

PAGE = ROOT / "docs" / "weights.md"


def test_programs_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    torch.manual_seed(0)
    torch.save(training_checkpoint("head"), tmp_path / "anystyle_head.ckpt")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path / "nothing"))
    (program,) = blocks(PAGE, "python")
    exec(program, {})
    assert capsys.readouterr().out == "True\n"


def test_the_table_names_every_file_that_is_not_bundled() -> None:
    rows = "".join(line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `"))
    told = set(re.findall(r"`(\w+)`", rows))
    assert {name for name, entry in weights.files().items() if not entry.bundled} <= told
