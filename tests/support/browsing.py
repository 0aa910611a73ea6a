"""Fixtures of tests in a real browser; a ``conftest.py`` imports them."""

import pytest

from tests.support.browser import browser, find_chromium


@pytest.fixture(scope="session")
def page(tmp_path_factory):
    """A browser's page; one for all tests."""
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium: apt-get install chromium, or name one in CHROMIUM")
    with browser(program, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture(autouse=True)
def same_window(request):
    """Every test finds the window as the first did."""
    yield
    if "page" in request.fixturenames:
        opened = request.getfixturevalue("page")
        opened.size(1280, 800)
        opened.call("Emulation.setEmulatedMedia", features=[])
        opened.call("Network.setBlockedURLs", urls=[])
        opened.errors.clear()
