"""A start page for the tests: its server, what a browser sends to it, and programs that only pretend to work."""

import http.client
import json
import sys
from io import BytesIO
from pathlib import Path

from PIL import Image

from anystyle_start.server import StartServer

PRETENDED = """
import json, sys, time
from pathlib import Path
words = sys.argv[1:]
if words[0] == "stylize":
    out = Path(words[words.index("--out") + 1])
    print("load the model …", file=sys.stderr, flush=True)
    text = words[words.index("--text") + 1]
    if text == "fail":
        print("anystyle: error: no cameras are found: first reason; second reason; "
              "reconstruction=feedforward poses=predicted does without", file=sys.stderr)
        sys.exit(2)
    out.mkdir(parents=True)
    (out / "half").write_text("written")
    while text == "wait" and not Path(__file__).with_name("go").exists():
        print("fit step 1 of 4: 20.0 dB, 9 s left …", file=sys.stderr, flush=True)
        time.sleep(0.05)
    report = {"style": text, "gaussians": 5, "views": 1, "inputs": ["a"]}
    (out / "report.json").write_text(json.dumps(report))
    (out / "scene.html").write_text("<h1>a scene</h1>")
"""
"""Instead of the program: styles in words say how a run goes."""


def pretended(folder: Path) -> list[str]:
    """The words that start the program that pretends; it waits for the file ``go``."""
    (folder / "program.py").write_text(PRETENDED)
    return [sys.executable, str(folder / "program.py")]


def jpeg(size=(64, 48), color="teal") -> bytes:
    """The bytes of a photograph."""
    data = BytesIO()
    Image.new("RGB", size, color).save(data, "JPEG")
    return data.getvalue()


class Client:
    """Asks a start page as its own page does."""

    def __init__(self, server: StartServer) -> None:
        self.address, self.token = server.url.split("/")[2], server.application.token

    def ask(self, method: str, path: str, body=None, **changes: str | None) -> tuple[int, bytes]:
        """The status and the body of an answer; ``changes`` are headers, ``None`` leaves one out."""
        headers: dict[str, str | None] = {"Host": self.address}
        if method == "POST":
            headers |= {"Origin": f"http://{self.address}", "X-Anystyle-Token": self.token}
        headers |= {name.replace("_", "-"): value for name, value in changes.items()}
        connection = http.client.HTTPConnection(self.address, timeout=60)
        data = body if isinstance(body, bytes) else json.dumps(body or {}).encode()
        sent = {name: value for name, value in headers.items() if value is not None}
        connection.request(method, path, data if method == "POST" else None, sent)
        reply = connection.getresponse()
        content = reply.read()
        connection.close()
        return reply.status, content

    def post(self, path: str, body=None) -> dict:
        """The answer to a change; an error is the text under ``error``."""
        return json.loads(self.ask("POST", path, body)[1])

    def scene(self, name: str) -> dict:
        """The state of a scene."""
        return json.loads(self.ask("GET", f"/state?scene={name}")[1])["scene"]

    def upload(self, scene: str, name: str, content: bytes, **changes: object) -> dict:
        """Send a file in one part."""
        query = {"name": name, "upload": "abc", "offset": 0, "total": len(content), **changes}
        words = "&".join(f"{key}={value}" for key, value in query.items())
        return self.post(f"/scenes/{scene}/files?{words}", content)

    def made(self, *names: str) -> str:
        """A scene with photographs."""
        scene = self.post("/scenes")["id"]
        for name in names:
            self.upload(scene, name, jpeg())
        return scene
