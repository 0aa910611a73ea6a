"""A real browser for tests: Chromium without a window, driven over its pipes; nothing but Chromium is needed."""

import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")


LOADED = "!!document.querySelector('[data-loaded]')"
"""A set of the form is shown, with every picture."""


def find_chromium() -> str | None:
    """The browser's program, or ``None``."""
    return os.environ.get("CHROMIUM") or next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """One page in a browser, through the DevTools protocol: messages are JSON, ended by a zero byte."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._to, self._from = to_browser, from_browser
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self.errors: list[str] = []
        self.downloads = Path()
        targets = self.call("Target.getTargets")["targetInfos"]
        target = next((one["targetId"] for one in targets if one["type"] == "page"), None)
        target = target or self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Ask the browser, and wait for its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._to, data) :]
        while True:
            reply = self._read()
            if reply.get("id") == self._number:
                if "error" in reply:
                    raise RuntimeError(f"{method}: {reply['error']}")
                return reply["result"]
            self._note(reply)

    def _read(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            part = os.read(self._from, 1 << 16)
            if not part:
                raise RuntimeError("the browser has gone")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(event["params"]["exceptionDetails"])[:500])
        elif event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            self.errors.append(event["params"]["entry"]["text"] + " " + event["params"]["entry"].get("url", ""))

    def open(self, url: str) -> None:
        """Go to a page, and wait until it has loaded."""
        self.call("Page.navigate", url=url)
        self.wait("document.readyState === 'complete' && !!document.querySelector('h1')")

    def value(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise AssertionError(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def wait(self, condition: str, seconds: float = 120) -> None:
        """Wait until a JavaScript expression is true."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            with suppress(AssertionError, RuntimeError):  # between two pages there is nothing to ask
                if self.value(condition):
                    return
            time.sleep(0.02)
        raise AssertionError(f"never true: {condition}; the page says {self.value('document.body.innerText')[:300]!r}")

    def key(self, key: str, text: str = "") -> None:
        """Press a key, as the keyboard does."""
        code = {"Enter": 13, "Backspace": 8, "Tab": 9, "Escape": 27, " ": 32}.get(key, ord(key[0]))
        typed = {"text": text} if text else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, windowsVirtualKeyCode=code, **typed)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=code)

    def click(self, selector: str) -> None:
        """Click the middle of an element with the mouse, scrolled into view as a person would."""
        middle = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            " e.scrollIntoView({block: 'center'});"
            " const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=middle[0], y=middle[1], button="left", clickCount=1)

    def type(self, text: str) -> None:
        """Type into what has the focus."""
        self.call("Input.insertText", text=text)

    def size(self, width: int, height: int, *, mobile: bool = False) -> None:
        """The window's size."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def picture(self, path: Path) -> None:
        """A screenshot of the window."""
        import base64

        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def accessible(self) -> list[dict[str, Any]]:
        """What a screen reader is told: role and name of every element that it does not pass over."""
        nodes = self.call("Accessibility.getFullAXTree")["nodes"]
        return [
            {"role": node["role"]["value"], "name": node.get("name", {}).get("value", "")}
            for node in nodes
            if not node.get("ignored")
        ]


SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
"""WebGL without a graphics card."""


@contextmanager
def browser(program: str, folder: Path, graphics: Sequence[str] = ("--disable-gpu",)):
    """A browser with a profile of its own in ``folder``; downloads go to ``folder / "downloads"``."""
    (folder / "downloads").mkdir(parents=True, exist_ok=True)
    child_in, to_browser = os.pipe()
    from_browser, child_out = os.pipe()
    arguments = [
        *(program, "--headless=new", "--no-sandbox", *graphics, "--disable-dev-shm-usage", "--no-first-run"),
        *("--disable-extensions", "--disable-background-networking", "--disable-component-update", "--mute-audio"),
        *("--remote-debugging-pipe", f"--user-data-dir={folder / 'profile'}", "about:blank"),
    ]
    quiet = os.open(os.devnull, os.O_WRONLY)
    # The browser reads from descriptor 3 and writes to 4; high copies first, so that neither is overwritten.
    copies = [os.dup2(child_in, 103, inheritable=False), os.dup2(child_out, 104, inheritable=False)]
    actions = [
        (os.POSIX_SPAWN_DUP2, copies[0], 3),
        (os.POSIX_SPAWN_DUP2, copies[1], 4),
        (os.POSIX_SPAWN_DUP2, quiet, 1),
        (os.POSIX_SPAWN_DUP2, quiet, 2),
    ]
    process = os.posix_spawn(program, arguments, os.environ, file_actions=actions, setpgroup=0)
    for descriptor in (child_in, child_out, quiet, *copies):
        os.close(descriptor)
    try:
        page = Page(to_browser, from_browser)
        page.downloads = folder / "downloads"
        page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(page.downloads))
        yield page
        with suppress(RuntimeError, OSError):
            page.call("Browser.close")
    finally:
        _end(process)
        os.close(to_browser)
        os.close(from_browser)


def _end(process: int, seconds: float = 5) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if os.waitpid(process, os.WNOHANG)[0]:
            break
        time.sleep(0.02)
    else:
        os.killpg(process, signal.SIGKILL)
        os.waitpid(process, 0)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)  # helpers that outlive it


def until(condition: Callable[[], Any], seconds: float = 120) -> Any:
    """Wait for something outside the browser."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError("it never happened")


def start(page: Page, url: str, clear: bool = True) -> None:
    """Open the form as in a browser that has never been there, and begin."""
    page.open(url)
    if clear:
        page.value("localStorage.clear()")
    page.click("#start")
