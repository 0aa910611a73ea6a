"""The example workflows in a ComfyUI that runs: set ``ANYSTYLE_COMFYUI`` to its address, such as http://127.0.0.1:8188.

The nodes are in its folder ``custom_nodes``; a cancelled prompt is expected to end within seconds.
"""

import json
import os
import time
import urllib.request

import pytest

from tests.support.browser import until
from tests.support.comfy_interface import ROOT, prompt_of

ADDRESS = os.environ.get("ANYSTYLE_COMFYUI", "")
DRAFT = "reconstruction=fit reconstruction.quality=draft"

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not ADDRESS, reason="ANYSTYLE_COMFYUI names no server")]


def call(path, body=None):
    content = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(ADDRESS + path, content)) as answer:
        return json.loads(answer.read() or "null")


def queue(name, options=DRAFT):
    graph = json.loads((ROOT / "example_workflows" / f"{name}.json").read_text())
    changes = {"AnyStyleLoadModel": {"options": options}, "AnyStyleRender": {"frames": 6}}
    answer = call("/prompt", {"prompt": prompt_of(graph, changes)})
    assert not answer["node_errors"]
    return answer["prompt_id"]


def finished(prompt, seconds=600):
    return until(lambda: call(f"/history/{prompt}"), seconds)[prompt]


@pytest.mark.parametrize("name", ["photographs_in_a_style", "text_and_picture_as_a_film"])
def test_workflows(name):
    history = finished(queue(name))
    assert history["status"]["status_str"] == "success" and history["outputs"], history["status"]


def test_cancel():
    prompt = queue("photographs_in_a_style", f"{DRAFT} reconstruction.seed={time.time_ns() % 2**31}")
    time.sleep(20)
    call("/interrupt", {})
    assert finished(prompt, 15)["status"]["messages"][-1][0] == "execution_interrupted"
