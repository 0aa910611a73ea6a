"""``docs/weights.md``: its program runs, its table is whole; its commands are run by tests/docs/test_commands.py."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from anystyle.vision import weights
from weights_cases import training_checkpoint

PAGE = Path(__file__).parents[2] / "docs" / "weights.md"
TEXT = PAGE.read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a small checkpoint lies under the name of the page's."""
    place = tmp_path_factory.mktemp("page")
    torch.manual_seed(0)
    torch.save(training_checkpoint("head"), place / "anystyle_head.ckpt")
    return place


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", weights.FOLDERS: str(folder / "nothing")}
    return subprocess.run(
        [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_programs_run(folder: Path) -> None:
    programs = blocks("python")
    assert len(programs) == 1
    done = run(folder, "-c", programs[0])
    assert done.returncode == 0, done.stderr
    assert done.stdout == "True\n"


def test_the_table_names_every_file_that_is_not_bundled() -> None:
    told = set(re.findall(r"`(\w+)`", "".join(line for line in TEXT.splitlines() if line.startswith("| `"))))
    assert {name for name, entry in weights.files().items() if not entry.bundled} <= told
