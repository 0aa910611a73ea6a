"""The pages as a site: `make docs` builds them all, and refuses links that lead nowhere."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted(path.stem for path in (ROOT / "docs").glob("*.md"))

pytest.importorskip("mkdocs", reason="the site is built by mkdocs: pip install --group docs")


def build(root: Path, out: Path) -> subprocess.CompletedProcess[str]:
    recipe = re.search(r"^docs:.*\n(?:\t.*\n)*?\t.*bin\)/mkdocs (.*)$", (ROOT / "Makefile").read_text(), re.I | re.M)
    assert recipe is not None
    command = [sys.executable, "-m", "mkdocs", *recipe[1].split(), "--site-dir", str(out)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)


def test_every_page_is_built_and_found_in_the_navigation(tmp_path):
    done = build(ROOT, tmp_path / "site")
    assert done.returncode == 0, done.stdout + done.stderr
    first = (tmp_path / "site" / "index.html").read_text()
    navigation = first[first.index('class="md-nav') : first.rindex("</nav>")]
    for page in PAGES:
        if page != "index":
            assert (tmp_path / "site" / page / "index.html").is_file()
            assert f'href="{page}/"' in navigation, page
    assert 'class="mermaid"' in (tmp_path / "site" / "design" / "index.html").read_text()
    reference = (tmp_path / "site" / "reference" / "contracts" / "index.html").read_text()
    assert "anystyle.contracts.backbone.Backbone.encode" in reference
    # What lies outside of the pages is named by its path.
    assert "01_stylize, <code>notebooks/01_stylize.ipynb</code>" in first
    assert not (tmp_path / "site" / "site").exists()


@pytest.mark.slow
def test_broken_links_are_refused(tmp_path):
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    (tmp_path / "src").symlink_to(ROOT / "src")
    with (tmp_path / "docs" / "index.md").open("a", encoding="utf-8") as file:
        file.write("\n[a](page.md)\n[a](design.md#section)\n[a](../program.py)\n")
    done = build(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert all(name in done.stdout + done.stderr for name in ("page.md", "#section", "program.py"))
