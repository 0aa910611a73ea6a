"""The helpers beside these tests are imported by their plain names."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from chromium import browser, find_chromium


@pytest.fixture(scope="session")
def page(tmp_path_factory):
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium: apt-get install chromium, or name one in CHROMIUM")
    with browser(program, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture(autouse=True)
def _clean(request):
    """Every test finds the window as the first did."""
    yield
    if "page" in request.fixturenames:
        opened = request.getfixturevalue("page")
        opened.size(1280, 800)
        opened.call("Emulation.setEmulatedMedia", features=[])
        opened.call("Network.setBlockedURLs", urls=[])
        opened.errors.clear()
