"""Every command that a page shows runs, those of a page one after the other in one folder, as a reader types them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import docs_world as world
from tests.support.docs_cases import (
    ENDS,
    FEWER,
    INSTEAD,
    NOT_RUN,
    PAGES,
    TELLS,
    ending,
    named,
    reason,
    shown,
    small,
    told,
)
from tests.support.program import Done, program

MORE = {"docs/add_a_plugin.md": world.of_plugins, "docs/data.md": world.of_data, "docs/user_study.md": world.of_study}
"""What a page's folder holds besides what all hold."""
BEFORE = {"docs/protocol.md": ("anystyle train -m experiment=tiny_style placement=head,full",)}
"""Commands of other pages whose results a page goes on with."""
KEPT = re.compile(r"anystyle (stylize|plugins \w+ \w+$|weights)")
"""Commands that leave nothing for those after them: they run on the first page that shows them, and not again."""
FIRST = ("README.md", "docs/add_a_plugin.md")
"""The commands of the other pages run in `make test-slow`."""
LINES = [(named(page), line) for page in PAGES for line in shown(page)]


class Reader:
    """Types the commands of one page."""

    def __init__(self, page: str, folder: Path) -> None:
        self.page, self.folder = page, folder
        self.environment = {key: value for key, value in os.environ.items() if not key.startswith("ANYSTYLE_")}
        self.environment |= {
            "OMP_NUM_THREADS": "1",
            "HF_HUB_OFFLINE": "1",
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        }

    def types(self, line: str) -> Done:
        """Run a command, in this process where that can be."""
        words = small(self.page, line)
        if self.page in ("README.md", "docs/add_a_network.md") and (self.folder / "plugins").is_dir():
            # Its reader is in the checkout, where this folder is looked into anyway.
            self.environment["ANYSTYLE_PLUGINS"] = "plugins"
        if words[0] == "export":
            self.environment |= dict([words[1].split("=", 1)])
            return Done(0, "", "")
        if words[0] == "anystyle" and not any(word.startswith("hydra/launcher") for word in words):
            done = program(words[1:], self.folder, self.environment)
            if words[1:3] == ["study", "form"]:
                world.answer_study(self.folder)
            return done
        # The jobs of a launcher are processes of their own: what launches them must be the program.
        words = [sys.executable, "-m", *words] if words[0] == "anystyle" else words
        done = subprocess.run(words, capture_output=True, text=True, cwd=self.folder, env=self.environment)
        return Done(done.returncode, done.stdout, done.stderr)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[] if page in FIRST else [pytest.mark.slow])
        for page in sorted({page for page, line in LINES if reason(line) is None})
    ],
)
def test_commands_of_a_page_run(page, tmp_path):
    world.make(tmp_path)
    MORE.get(page, lambda folder: None)(tmp_path)
    reader = Reader(page, tmp_path)
    for line in BEFORE.get(page, ()):
        assert reader.types(line).status == 0
    wrong = []
    for line in (line for where, line in LINES if where == page and reason(line) is None):
        if KEPT.match(line) and next(where for where, other in LINES if other == line) != page:
            continue
        done, end = reader.types(line), ending(line)
        errors = [text for text in done.err.splitlines() if text.startswith("anystyle: error: ")]
        if end is None:
            fine = done.status == 0 and told(line) in done.out
        else:
            fine = done.status == 2 and len(errors) == 1 and re.search(end, errors[0]) is not None
        if not fine or "Traceback" in done.err:
            wrong.append(f"{line}\nends with {done.status}: {done.out[-500:]}{done.err[-1500:]}")
    assert not wrong, "\n\n".join(wrong)


def test_what_is_said_of_commands_is_said_of_some():
    """No reason, ending or stand-in outlives its command."""
    lines = [line for _, line in LINES]
    for pattern in (*NOT_RUN, *ENDS, *TELLS):
        assert any(re.match(pattern, line) for line in lines), pattern
    assert set(INSTEAD) <= set(lines)
    for page, words in FEWER.items():
        assert set(words) <= {word for where, line in LINES if where == page for word in shlex.split(line)}, page
    assert all(shlex.split(line) for line in lines)
    assert not [line for line in lines if reason(line) and ending(line)]
