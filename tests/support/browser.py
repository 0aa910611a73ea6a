"""A real browser for tests: Debian's Chromium without a window, driven by Playwright."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Error, Page, sync_playwright

NAMES = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
ARGUMENTS = (  # with WebGL without a graphics card
    *("--no-sandbox", "--no-first-run", "--disable-gpu", "--enable-unsafe-swiftshader"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
PATIENCE = 120
"""Seconds after which a page hangs; a busy machine takes long for an answer."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The browser of a module; its loop of events has ended when the next begins."""
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip("there is no Chromium: apt install chromium, or name one in CHROMIUM")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that has never been anywhere."""
    page = new_page(browser)
    yield page
    page.context.close()


@pytest.fixture
def errors(page: Page) -> list[str]:
    """What the page says on its console is wrong, up to now."""
    return errors_of(page)


def new_page(browser: Browser, **options: Any) -> Page:
    """A page with a profile of its own."""
    page = browser.new_page(**{"viewport": {"width": 1280, "height": 800}} | options)
    page.set_default_timeout(1000 * PATIENCE)
    return page


def errors_of(page: Page) -> list[str]:
    """What a page will say on its console is wrong, as it comes."""
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(f"{said.text} {said.location}") if said.type == "error" else None)
    return errors


def phone(page: Page, width: int, height: int) -> None:
    """Give the page the window of a phone."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
    page.context.new_cdp_session(page).send("Emulation.setDeviceMetricsOverride", size)


def accessible(page: Page) -> list[tuple[str, str]]:
    """What a screen reader is told: role and name of every element that it does not pass over."""
    nodes = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    return [(node["role"]["value"], node.get("name", {}).get("value", "")) for node in nodes if not node.get("ignored")]


def drop(page: Page, *files: Path) -> None:
    """Drop files on the page with the mouse."""
    session = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 300, "y": 300, "data": data})


def wait(page: Page, condition: str, seconds: float = PATIENCE) -> None:
    """Wait until a JavaScript expression is true; Playwright's own waiting is forbidden by a page's security policy."""

    def holds() -> bool:
        try:
            return bool(page.evaluate(condition))
        except Error:  # between two pages there is nothing to ask
            return False

    until(holds, seconds)


def until(condition: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    """Wait for something outside the browser."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError("it never happened")
